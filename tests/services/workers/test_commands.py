"""
Writes by name that come over the engine: who answers, what, and how many at once.
"""

from __future__ import annotations

import asyncio
import json
from typing import Any

from libmodbus_py import ModbusTimeoutError
from libmodbus_py.services.fleet.commands import Commands
from libmodbus_py.services.fleet.statistics import FleetStatistics
from libmodbus_py.services.workers.commands import MOST_WAITING, CommandService
from tests.services.workers.memory_engine import MemoryClient, run

SUBJECT = "modbus.write.pump.setpoint"

INBOX = "_INBOX.u9ii73oAyVwgjXVUkC6cqN.1"


class Written:
    """Devices that take writes, at once or when they may; the pump is the only one."""

    def __init__(self) -> None:
        self.statistics = FleetStatistics()
        self.values: list[dict[str, Any]] = []
        self.may_go_on = asyncio.Event()
        self.may_go_on.set()

    def unknown(self, device: str, point: str) -> str:
        return ""

    async def write(self, device: str, values: dict[str, Any]) -> None:
        await self.may_go_on.wait()
        if values == {"setpoint": 99}:
            raise ModbusTimeoutError("no answer")
        self.values.append({device: values})


class Trial:
    """A service with its client; what refuses is asked by the name of the device."""

    def __init__(self, refusal: str | None = None) -> None:
        self.client = MemoryClient()
        self.devices = Written()
        self.refusal = refusal
        commands = Commands(self.devices)
        commands.refusal = lambda device: self.refusal if device == "pump" else f"no {device}"
        # As much of a client as the service uses.
        self.service = CommandService(self.client, commands)  # type: ignore[arg-type]

    async def ask(self, data: bytes, *, subject: str = SUBJECT, reply: str = INBOX) -> None:
        await self.client.deliver(subject, data, reply)
        await settle()

    @property
    def answers(self) -> list[tuple[str, dict[str, Any]]]:
        told = [(subject, json.loads(data)) for subject, data in self.client.published]
        assert all(outcome.pop("time") for _, outcome in told)
        return told


async def settle() -> None:
    """Let all go on that can."""
    for _ in range(10):
        await asyncio.sleep(0)


def test_a_write_is_carried_out_and_answered_twice() -> None:
    """To who asked, and to who can have no answer."""

    async def main() -> None:
        trial = Trial()
        await trial.service.begin()
        assert list(trial.client.subscribed) == ["modbus.write.*.*"]
        await trial.ask(b'{"value": 21.5, "id": "a"}')
        assert trial.devices.values == [{"pump": {"setpoint": 21.5}}]
        outcome = {"ok": True, "id": "a"}
        assert trial.answers == [(INBOX, outcome), ("modbus.written.pump.setpoint", outcome)]

    run(main())


def test_who_wants_no_answer_gets_none() -> None:
    async def main() -> None:
        trial = Trial()
        await trial.service.begin()
        await trial.ask(b"20", reply="")
        assert trial.answers == [("modbus.written.pump.setpoint", {"ok": True})]

    run(main())


def test_a_failure_is_answered_with_its_reason() -> None:
    async def main() -> None:
        trial = Trial()
        await trial.service.begin()
        await trial.ask(b"99")
        assert trial.answers[0] == (INBOX, {"ok": False, "error": "no answer"})
        assert trial.devices.statistics.refused_commands == 1

    run(main())


def test_a_device_that_another_worker_has_is_left_to_that() -> None:
    async def main() -> None:
        trial = Trial(refusal="")
        await trial.service.begin()
        await trial.ask(b"20")
        assert trial.answers == []
        assert trial.devices.values == []

    run(main())


def test_a_refusal_in_the_name_of_all_is_answered() -> None:
    async def main() -> None:
        trial = Trial(refusal="no worker polls 'pump' now")
        await trial.service.begin()
        await trial.ask(b'{"value": 20, "id": 7}')
        refused = {"ok": False, "error": "no worker polls 'pump' now", "id": 7}
        assert trial.answers[0] == (INBOX, refused)
        await trial.ask(b"20")
        assert trial.answers[2] == (INBOX, {"ok": False, "error": "no worker polls 'pump' now"})
        assert trial.devices.values == []

    run(main())


def test_answers_have_letters_as_they_are() -> None:
    async def main() -> None:
        trial = Trial(refusal="no worker polls 'kälte' now")
        await trial.service.begin()
        await trial.ask(b"20")
        assert "'kälte'".encode() in trial.client.published[0][1]

    run(main())


def test_names_with_special_characters_are_understood() -> None:
    async def main() -> None:
        trial = Trial()
        await trial.service.begin()
        await trial.ask(b"20", subject="modbus.write.hall%2E2.set%20point")
        assert trial.answers[0] == (INBOX, {"ok": False, "error": "no hall.2"})
        assert trial.answers[1][0] == "modbus.written.hall%2E2.set%20point"

    run(main())


def test_what_cannot_be_answered_is_not_told_to_anybody() -> None:
    """The engine is gone meanwhile: the write was carried out, and nothing is raised."""

    async def main() -> None:
        trial = Trial()
        await trial.service.begin()
        trial.client.is_broken = True
        await trial.ask(b"20")
        assert trial.devices.values == [{"pump": {"setpoint": 20}}]
        assert trial.answers == []

    run(main())


def test_a_flood_is_dropped_beyond_a_bound_and_makes_room_again() -> None:
    async def main() -> None:
        trial = Trial()
        trial.devices.may_go_on.clear()
        await trial.service.begin()
        for _ in range(MOST_WAITING + 50):
            await trial.client.deliver(SUBJECT, b"20", INBOX)
        trial.devices.may_go_on.set()
        await settle()
        assert len(trial.answers) == 2 * MOST_WAITING
        await trial.ask(b"21")
        assert trial.devices.values[-1] == {"pump": {"setpoint": 21}}

    run(main())


def test_the_end_of_the_service_ends_what_waits() -> None:
    async def main() -> None:
        trial = Trial()
        trial.devices.may_go_on.clear()
        await trial.service.begin()
        await trial.ask(b"20")
        await trial.service.end()
        trial.devices.may_go_on.set()
        await settle()
        assert trial.answers == []

    run(main())
