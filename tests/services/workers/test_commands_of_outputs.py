"""
Commands that outputs of several workers receive, as those of one broker do: one worker answers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.commands import Commands, Wanted
from tests.services.workers.trial import LEASE, Trial
from tests.simulation.workers import push_fleet


class Broker:
    """An output that is handed what each of its workers gets: all commands."""

    name = "broker"
    takes_commands = True

    def attach(self, commands: Commands) -> None:
        self.commands = commands

    async def open(self) -> None: ...

    async def write(self, readings: Sequence[Reading]) -> None: ...

    async def close(self) -> None: ...


def test_one_of_two_workers_answers() -> None:
    trial = Trial(4)
    brokers = [Broker(), Broker()]

    async def ask(device: str, point: str, value: object) -> dict[str, Any]:
        outcomes = [await each.commands.answer(device, point, Wanted(value)) for each in brokers]
        (outcome,) = [each for each in outcomes if each is not None]
        del outcome["time"]
        return outcome

    async def main() -> None:
        for name, broker in zip("ab", brokers, strict=True):
            await trial.start(name, outputs=[broker])
        await trial.settle()
        for at in range(4):
            assert await ask(f"d{at}-1", "setpoint", 20 + at) == {"ok": True}
            assert trial.levels.holding_registers[1] == 20 + at
        refused = {"ok": False, "error": "d0-1 has no point 'nothing'"}
        assert await ask("d0-1", "nothing", 20) == refused
        refused = {"ok": False, "error": "there is no device 'nothing'"}
        assert await ask("nothing", "setpoint", 20) == refused
        await push_fleet(trial.engine, trial.devices(zone="north"), trial.settings)
        await trial.until(lambda: not trial.workers["a"].polling.fleet.devices, LEASE)
        await trial.until(lambda: not trial.workers["b"].polling.fleet.devices, LEASE)
        refused = {"ok": False, "error": "no worker polls 'd0-1' now"}
        assert await ask("d0-1", "setpoint", 20) == refused

    trial.run(main)
