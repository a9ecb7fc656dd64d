"""
Commands to one device: each begins when the one before is over, all its attempts included.
"""

from __future__ import annotations

import asyncio
from typing import Any

from libmodbus_py.services.fleet.commands import Commands, Wanted
from libmodbus_py.services.fleet.statistics import FleetStatistics
from tests.services.fleet.fleets import Peer, good, meter, polling, simulated_run


class Devices:
    """Devices whose writes end when they may; `gone` are those that were removed meanwhile."""

    def __init__(self) -> None:
        self.statistics = FleetStatistics()
        self.may_end: dict[str, asyncio.Event] = {}
        self.begun: list[tuple[str, Any]] = []
        self.gone: set[str] = set()

    def unknown(self, device: str, point: str) -> str:
        return f"there is no device {device!r}" if device in self.gone else ""

    async def write(self, device: str, values: dict[str, Any]) -> None:
        self.begun.append((device, *values.items()))
        await self.may_end.setdefault(device, asyncio.Event()).wait()


def test_a_command_waits_for_the_one_before_and_for_no_other_device() -> None:
    async def main() -> None:
        devices = Devices()
        commands = Commands(devices)

        async def write(device: str, point: str, value: int) -> Any:
            return await commands.answer(device, point, Wanted(value))

        tasks = [
            asyncio.create_task(write(*each))
            for each in (("pump", "level", 1), ("pump", "limit", 2), ("fan", "level", 3))
        ]
        for _ in range(10):
            await asyncio.sleep(0)
        assert devices.begun == [("pump", ("level", 1)), ("fan", ("level", 3))]
        devices.may_end["pump"].set()
        devices.may_end["fan"].set()
        await asyncio.gather(*tasks)
        assert devices.begun[2] == ("pump", ("limit", 2))
        assert (tasks[1].result() or {})["ok"]

    asyncio.run(main())


def test_a_command_that_waited_is_refused_if_its_device_is_gone_then() -> None:
    async def main() -> None:
        devices = Devices()
        commands = Commands(devices)
        tasks = [
            asyncio.create_task(commands.answer("pump", "level", Wanted(value))) for value in (1, 2)
        ]
        await asyncio.sleep(0)
        devices.gone.add("pump")
        devices.may_end["pump"].set()
        outcomes = await asyncio.gather(*tasks)
        assert [each and each.get("error") for each in outcomes] == [
            None,
            "there is no device 'pump'",
        ]
        assert len(devices.begun) == 1

    asyncio.run(main())


def test_a_write_that_is_repeated_is_not_overtaken_by_the_next() -> None:
    """The first attempt gets no answer: the device must hear 20, 20 and then 25."""
    written: list[int] = []

    async def forgetful(request: bytes) -> bytes | None:
        if request[7] == 6:
            written.append(int.from_bytes(request[10:12], "big"))
            if len(written) == 1:
                return None
        return await good(request)

    async def go() -> None:
        async with Peer(forgetful) as peer:
            url = f"{peer.url}?timeout=0.5&retries=1&max_in_flight=4"
            async with polling(meter("north", url, interval=60)) as (fleet, _):
                outcomes = await asyncio.gather(
                    fleet.commands.answer("north", "setpoint", Wanted(20)),
                    fleet.commands.answer("north", "setpoint", Wanted(25)),
                )
                assert [each and each["ok"] for each in outcomes] == [True, True]
        assert written == [20, 20, 25]

    simulated_run(go())
