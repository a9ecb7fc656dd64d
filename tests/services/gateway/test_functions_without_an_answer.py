"""
A device that leaves a function without an answer: only that function rests, in simulated time.
"""

from __future__ import annotations

import asyncio
import logging

import pytest

from libmodbus_py.services.gateway.line import NO_ANSWER
from tests.services.gateway.test_line import READ, TIMEOUT, Asker, Plant
from tests.simulation.scripted import Write

UNKNOWN = "08 0000 0001"
INPUTS = "04 0000 0001"


class Choosy(Plant):
    """A plant whose units leave some functions without an answer."""

    def __init__(self, url: str, unanswered: set[int]) -> None:
        super().__init__(url)
        self.unanswered = unanswered
        if url.startswith("tcp"):
            self.url = self.peer.url + "?timeout=0.5"

    def _answer(self, request: bytes, write: Write) -> None:
        function = request[7 if self.url.startswith("tcp") else 1]
        if function in self.unanswered:
            self.asked.append(-function)
        else:
            super()._answer(request, write)


def test_a_unit_that_answers_nothing_rests(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, logger="libmodbus_py.services.gateway")
    plant = Choosy("rtu:///dev/line?timeout=0.5", set())

    async def main() -> None:
        asker = Asker()
        for request in (READ, UNKNOWN):
            plant.ask(9, asker, request)
            await asyncio.sleep(1)
        plant.unanswered = {3, 4, 8}
        plant.ask(9, asker, UNKNOWN)
        await asyncio.sleep(TIMEOUT + 0.1)
        assert not plant.unit(9).is_silent
        plant.ask(9, asker, READ)
        plant.ask(9, asker, INPUTS)
        await asyncio.sleep(2 * TIMEOUT + 0.1)
        assert plant.unit(9).is_silent
        assert plant.asked.count(-4) == 0  # nothing of the unit was answered any more
        plant.unanswered = set()
        await asyncio.sleep(2 * TIMEOUT)
        plant.ask(9, asker)
        await asyncio.sleep(0.4)
        assert not plant.unit(9).is_silent
        plant.ask(9, asker, UNKNOWN)  # it rests no longer than its unit
        await asyncio.sleep(1)
        assert asker.answers[-1] == "0800000001"
        assert [text.partition(": ")[2] for text in caplog.messages] == [
            "unit 9 does not answer function 8",
            "unit 9 does not answer",
            "unit 9 answers again",
        ]

    plant.run(main)


def test_requests_of_the_function_that_wait_are_refused_together() -> None:
    plant = Choosy("rtu:///dev/line?timeout=0.5", {8})

    async def main() -> None:
        reader, asker = Asker("192.0.2.1"), Asker("192.0.2.2")
        plant.ask(9, reader)
        await asyncio.sleep(1)
        plant.ask(9, asker, UNKNOWN)
        plant.ask(9, asker, UNKNOWN)
        plant.ask(9, reader)
        await asyncio.sleep(3 * TIMEOUT)
        assert asker.answers == [f"88{NO_ANSWER:02x}"] * 2
        assert plant.asked == [9, -8, 9]
        assert len(reader.answers) == 2

    plant.run(main)


def test_the_function_answers_again(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, logger="libmodbus_py.services.gateway")
    plant = Choosy("rtu:///dev/line?timeout=0.5", {8})

    async def main() -> None:
        asker = Asker()
        plant.ask(9, asker)
        plant.ask(9, asker, UNKNOWN)
        await asyncio.sleep(4 * TIMEOUT)
        plant.unanswered = set()
        for _ in range(2):
            plant.ask(9, asker, UNKNOWN)
            await asyncio.sleep(1)
        assert asker.answers[2:] == ["0800000001", "0800000001"]
        assert caplog.messages[-1].endswith("unit 9 answers function 8 again")

    plant.run(main)
