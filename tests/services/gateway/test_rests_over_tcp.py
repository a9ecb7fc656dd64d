"""
A silent unit behind a line with transaction ids: how often it is asked, and what that costs others.
"""

from __future__ import annotations

import asyncio

from tests.services.gateway.test_line import READ, Asker, Plant
from tests.simulation.network import Network
from tests.support.cases import each_case

TIMEOUT = 0.5
FIRST_REST = 2 * TIMEOUT
READ_INPUTS = "04 0000 0001"


def time_of(network: Network) -> float:
    return network.events.now


class Watched(Plant):
    """A plant that notes when unit 2 is asked after it became silent, and when its rest began."""

    def __init__(self) -> None:
        super().__init__(f"tcp://10.0.0.1?timeout={TIMEOUT}")
        self.times: list[float] = []
        self.rests_since = 0.0

    async def poll(self, seconds: float, every: int, *requests: str) -> None:
        """Ask two units that answer 50 times a second, and unit 2 in each so-manieth turn."""
        until, turn = time_of(self.network) + seconds, 0
        while (now := time_of(self.network)) < until:
            before = len(self.asked)
            self.ask(1, Asker())
            self.ask(3, Asker())
            turn += 1
            for request in requests if turn % every == 0 else ():
                self.ask(2, Asker(), request)
            await asyncio.sleep(0.02)
            if 2 in self.silent:
                self.times += [now] * self.asked[before:].count(2)
            if not self.rests_since and self.unit(2).is_silent:
                self.rests_since = now


@each_case("requests", [(READ,), (READ, READ), (READ, READ_INPUTS)])
@each_case("every", [1, 2, 5, 9, 15])
def test_a_silent_unit_is_asked_once_at_the_end_of_each_rest(
    requests: tuple[str, ...], every: int
) -> None:
    plant = Watched()

    async def main() -> None:
        await plant.poll(1.0, every, *requests)  # several are in flight by now
        plant.silent.add(2)
        await plant.poll(6.0, every, *requests)
        assert plant.rests_since
        first, second = (at - plant.rests_since for at in plant.times if at >= plant.rests_since)
        assert first >= FIRST_REST - 0.02
        assert second >= first + 2 * FIRST_REST

    plant.run(main)
