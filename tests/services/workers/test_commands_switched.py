"""
Whether a fleet takes commands is pushed like its devices, and followed at once.
"""

from __future__ import annotations

import asyncio
import json

import nats.errors
import pytest

from libmodbus_py.services.workers.records import FleetSettings
from tests.services.workers.trial import LEASE, Trial
from tests.simulation.workers import push_fleet


async def switch(trial: Trial, commands: bool) -> None:
    settings = FleetSettings(LEASE, commands=commands)
    await push_fleet(trial.engine, trial.devices(), settings)


@pytest.mark.parametrize("at_first", [True, False])
def test_workers_follow_what_is_pushed(at_first: bool) -> None:
    trial = Trial(2, settings=FleetSettings(LEASE, commands=at_first))

    async def main() -> None:
        await trial.start("a", "b")
        await trial.settle()
        client = trial.engine.client()

        async def ask(value: int) -> bool:
            try:
                subject, data = "modbus.write.d0-1.setpoint", str(value).encode()
                answer = await client.request(subject, data, timeout=2)
            except nats.errors.TimeoutError:
                return False
            return bool(json.loads(answer.data)["ok"])

        commands = at_first
        for value in (20, 21, 22, 23):
            assert await ask(value) is commands
            assert (trial.levels.holding_registers[1] == value) is commands
            commands = not commands
            await switch(trial, commands)
            await asyncio.sleep(0.1)
        await client.close()

    trial.run(main)


def test_commands_that_wait_are_not_carried_out_any_more() -> None:
    trial = Trial(1, settings=FleetSettings(LEASE, commands=True))

    async def main() -> None:
        await trial.start("a")
        await trial.settle()
        client = trial.engine.client()
        written: list[int] = []
        # The device takes as long for a write as the push takes to arrive.
        fleet = trial.workers["a"].polling.fleet
        may_end = asyncio.Event()

        async def slow(device: str, values: dict[str, int]) -> None:
            written.extend(values.values())
            await may_end.wait()

        fleet.write = slow  # type: ignore[method-assign,assignment]
        for value in (20, 21, 22):
            await client.publish("modbus.write.d0-1.setpoint", str(value).encode())
        await asyncio.sleep(0.1)
        await switch(trial, False)
        await asyncio.sleep(0.1)
        may_end.set()
        await asyncio.sleep(1)
        assert written == [20]
        await client.close()

    trial.run(main)
