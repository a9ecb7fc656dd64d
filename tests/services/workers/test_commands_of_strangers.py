"""
Commands as anybody may publish them who has no other right: to names in other spellings, with
replies to subjects that only workers may publish to, with values that nobody can send.
"""

from __future__ import annotations

import asyncio
import json
from typing import Any

from libmodbus_py.services.workers.records import FleetSettings
from tests.services.workers.trial import LEASE, Trial
from tests.simulation.engine import EngineClient

INBOX = "_INBOX.u9ii73oAyVwgjXVUkC6cqN"


class Heard:
    """What a client hears that listens to everything."""

    def __init__(self, trial: Trial) -> None:
        self.client: EngineClient = trial.engine.client()
        self.messages: list[tuple[str, Any]] = []
        self.trial = trial

    async def begin(self) -> None:
        for subject in ("$JS.>", "$KV.>", "modbus.write.>", "modbus.written.>", "_INBOX.>", "up.>"):
            await self.client.subscribe(subject, cb=self.note)

    async def note(self, message: Any) -> None:
        told = json.loads(message.data)
        if isinstance(told, dict):
            told.pop("time", None)
        self.messages.append((message.subject, told))

    async def sent(self, subject: str, data: bytes, reply: str = "") -> list[tuple[str, Any]]:
        """Return what is heard after a command was sent, without the command."""
        self.messages.clear()
        await self.client.publish(f"modbus.write.{subject}", data, reply)
        await asyncio.sleep(2)
        return [each for each in self.messages if not each[0].startswith("modbus.write.")]


def heard(main: Any, connections: int = 2) -> Trial:
    """Run a test with two workers that take commands, and a client that listens."""
    trial = Trial(connections, settings=FleetSettings(LEASE, commands=True))

    async def whole() -> None:
        await trial.start("a", "b")
        await trial.settle()
        listener = Heard(trial)
        await listener.begin()
        await main(listener)
        await listener.client.close()

    trial.run(whole)
    return trial


def test_outcomes_are_sent_to_inboxes_only() -> None:
    """A worker may purge streams, and must not do so because a command has such a reply."""

    async def main(listener: Heard) -> None:
        told = ("modbus.written.d0-1.setpoint", {"ok": True})
        for reply in (
            "$JS.API.STREAM.PURGE.modbus-readings",
            "$KV.modbus-fleet.settings",
            "modbus.write.d0-1.setpoint",
            "up.and.away",
            f"_INBOX.{'x' * 4000}",
            "_GR_.a.b.$JS.API.STREAM.PURGE.modbus-readings",
        ):
            assert await listener.sent("d0-1.setpoint", b"20", reply) == [told]
        for reply in (INBOX, f"{INBOX}.9", "_INBOX_operator.x", "_R_.a.b", f"_GR_.a.b.{INBOX}"):
            heard = await listener.sent("d0-1.setpoint", b"20", reply)
            assert [each for each in heard if each[0] != reply] == [told]
        assert await listener.sent("d0-1.setpoint", b"20", INBOX) == [(INBOX, {"ok": True}), told]

    heard(main)


def test_names_are_taken_in_one_spelling_only() -> None:
    """A broker that denies modbus.write.d0-1.> does not know that d%30-1 is the same."""

    async def main(listener: Heard) -> None:
        for subject in (
            "d%30-1.setpoint",
            "d0-1.se%74point",
            "d0%2d1.setpoint",
            "d0-1.setpoint%",
            "d0-1.%FF",
            "d0-1.set%0Apoint",
            f"{'d' * 101}.setpoint",
            f"{'%25' * 1500}.setpoint",
        ):
            assert await listener.sent(subject, b"20", INBOX) == []
        assert await listener.sent("d0-1.setpoint", b"21", INBOX)

    trial = heard(main)
    assert trial.levels.holding_registers[1] == 21


def test_values_that_are_no_json_are_refused() -> None:
    async def main(listener: Heard) -> None:
        for data in (
            b"NaN",
            b"[1, -Infinity]",
            b"1e999",
            b'{"value": 1e999}',
            b'{"value": 20, "id": "\\ud800"}',
            b'"\\udfff"',
            "20".encode("utf-16"),
            b"\xff",
            b"[" * 4000,
            b'{"a":' * 800,
            b"[[[" + b'"\\' * 2000,
        ):
            (answer, told) = await listener.sent("d0-1.setpoint", data, INBOX)
            assert answer[0] == INBOX
            assert answer[1]["error"].startswith("it must be a value in JSON, not ")
            assert told[1] == answer[1]

    trial = heard(main)
    assert trial.levels.holding_registers[1] == 0


def test_an_unknown_point_is_refused_without_a_search_for_similar_ones() -> None:
    async def main(listener: Heard) -> None:
        (answer, _) = await listener.sent("d0-1.setpoin", b"20", INBOX)
        assert answer[1] == {"ok": False, "error": "d0-1 has no point 'setpoin'"}

    heard(main)
