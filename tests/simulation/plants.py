"""A plant of scripted units on one connection, which a fleet polls in simulated time."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from libmodbus_py import Fleet, Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig, Reading
from tests.services.fleet.fleets import NETWORK
from tests.support.driver import rtu
from tests.support.peers import mbap

from .scripted import Scripted, Write

# Two requests: the points are too far apart for one.
MAP = RegisterMap([Point("near", "holding_registers", 0), Point("far", "holding_registers", 9)])
ONE = RegisterMap([Point("near", "holding_registers", 0)])


class Plant:
    """A fleet, and units whose registers hold their addresses, in simulated time."""

    def __init__(self, url: str = "rtu:///dev/line", options: str = "?timeout=0.5") -> None:
        self.network = NETWORK.get()
        self.asked: list[tuple[float, int, int]] = []
        self.silent: set[int] = set()
        self.mute: set[int] = set()
        self.refusing: set[int] = set()
        self.missing: dict[int, set[int]] = {}
        self.damaging: set[int] = set()
        self.delay = 0.02
        self.delays: dict[int, float] = {}
        self.peer = Scripted(self.network, url, self._answer)
        self.url = self.peer.url + options
        self.fleet: Fleet
        self.readings: list[Reading] = []

    def _answer(self, request: bytes, write: Write) -> None:
        has_ids = self.url.startswith("tcp")
        unit, body = (request[6], request[7:]) if has_ids else (request[0], request[1:-2])
        address, count = (int.from_bytes(body[at : at + 2], "big") for at in (1, 3))
        self.asked.append((self.now, unit, address))
        cells = range(address, address + count)
        if unit in self.silent or not self.mute.isdisjoint(cells):
            return
        pdu = bytes([3, 2 * count]) + b"".join(cell.to_bytes(2, "big") for cell in cells)
        if unit in self.refusing or not self.missing.get(unit, set()).isdisjoint(cells):
            pdu = b"\x83\x02"
        answer = mbap(request, pdu) if has_ids else rtu(bytes([unit, *pdu]).hex())
        if unit in self.damaging:
            answer = answer[:-1] + bytes([answer[-1] ^ 1])
        write(answer, self.delays.get(unit, self.delay))

    @property
    def now(self) -> float:
        return self.network.events.now

    def device(self, unit: int, points: RegisterMap = ONE, **options: Any) -> DeviceConfig:
        settings = {"interval": 1.0, "unit": unit, **options}
        return DeviceConfig(f"device {unit}", self.url, points, **settings)

    @asynccontextmanager
    async def polls(
        self, *devices: DeviceConfig, may_ask: Callable[[str], bool] | None = None
    ) -> AsyncIterator[None]:
        """Poll devices, and collect the readings."""
        self.fleet = Fleet(devices, may_ask=may_ask)
        readings = self.fleet.readings()

        async def collect() -> None:
            async for reading in readings:
                self.readings.append(reading)

        collecting = asyncio.create_task(collect())
        async with self.fleet:
            yield
        await collecting

    def units(self, since: float = 0.0) -> list[int]:
        return [unit for at, unit, _ in self.asked if at >= since]

    def times(self, unit: int) -> list[float]:
        return [at for at, request, _ in self.asked if request == unit]

    def taken(self, unit: int = 1) -> int:
        """Return the number of requests to a unit since the last call, and forget them."""
        count = len(self.times(unit))
        self.asked = [request for request in self.asked if request[1] != unit]
        return count
