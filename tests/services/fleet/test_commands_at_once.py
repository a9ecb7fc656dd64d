"""
Commands that devices take their time for: as many as are promised wait at once.
"""

from __future__ import annotations

import asyncio
from typing import Any

from libmodbus_py.services.fleet.commands import Commands, Wanted
from libmodbus_py.services.fleet.statistics import FleetStatistics


class SlowDevices:
    """Devices whose writes end when they may."""

    def __init__(self) -> None:
        self.statistics = FleetStatistics()
        self.may_end = asyncio.Event()
        self.begun = 0

    def unknown(self, device: str, point: str) -> str:
        return ""

    async def write(self, device: str, values: dict[str, Any]) -> None:
        self.begun += 1
        await self.may_end.wait()


def test_commands_beyond_those_that_may_wait_are_refused_until_others_end() -> None:
    async def main() -> None:
        devices = SlowDevices()
        commands = Commands(devices)

        async def write(device: str = "pump") -> str:
            outcome = await commands.answer(device, "level", Wanted(1))
            assert outcome is not None
            return str(outcome.get("error", "written"))

        waiting = [asyncio.create_task(write(f"pump {at}")) for at in range(100)]
        refused = await next(asyncio.as_completed(waiting))
        assert refused == f"{devices.begun} writes are already under way"
        assert 1 < devices.begun < 100
        devices.may_end.set()
        ends = await asyncio.gather(*waiting)
        assert ends.count("written") == devices.begun
        assert await write() == "written"
        assert devices.statistics.commands == devices.begun
        assert devices.statistics.refused_commands == ends.count(refused)

    asyncio.run(main())
