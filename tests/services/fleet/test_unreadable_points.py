"""
Fleets and devices that refuse some points, or are silent about some, in simulated time.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from libmodbus_py import Fleet, Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.services.fleet.poller import DeviceState
from tests.services.fleet.fleets import while_polled
from tests.simulation.network import Network
from tests.simulation.scripted import Scripted, Write
from tests.support.peers import mbap

H = "holding_registers"
TWENTY = [Point(f"p{at}", H, at) for at in range(20)]
APART = RegisterMap([Point("a", H, 0), Point("b", H, 10), Point("c", H, 20)])


class Plant:
    """
    A fleet and a device with units, whose registers hold their addresses.

    Attributes:
        missing: addresses that each unit refuses; `silent`: those about which it is silent.
        asked: time, unit, address and count of each request.
    """

    def __init__(self) -> None:
        self.network = Network()
        self.map = RegisterMap(TWENTY)
        self.missing: dict[int, set[int]] = {}
        self.silent: set[int] = set()
        self.asked: list[tuple[float, int, int, int]] = []
        self.peer = Scripted(self.network, "tcp://10.0.0.1", self._answer)
        self.readings: list[Any] = []
        self.fleet: Fleet

    @property
    def now(self) -> float:
        return self.network.events.now

    def _answer(self, request: bytes, write: Write) -> None:
        address, count = (int.from_bytes(request[at : at + 2], "big") for at in (8, 10))
        self.asked.append((self.now, request[6], address, count))
        cells = set(range(address, address + count))
        if cells & self.silent:
            return
        if cells & self.missing.get(request[6], set()):
            write(mbap(request, b"\x83\x02"), 0.01)
            return
        data = b"".join(cell.to_bytes(2, "big") for cell in sorted(cells))
        write(mbap(request, bytes([3, len(data)]) + data), 0.01)

    def device(self, unit: int, points: RegisterMap | None = None, **options: Any) -> DeviceConfig:
        given = {"interval": 10.0, "unit": unit, "timeout": 1.0, **options}
        return DeviceConfig(f"device {unit}", self.peer.url, points or self.map, **given)

    def run(self, main: Callable[[], Awaitable[None]], *devices: DeviceConfig) -> None:
        async def whole() -> None:
            self.fleet = Fleet(devices)
            await while_polled(self.fleet, main, self.readings.append)

        self.network.run(whole)

    def taken(self, unit: int = 1) -> int:
        """Return the number of requests to a unit since the last call, and forget them."""
        count = sum(each[1] == unit for each in self.asked)
        self.asked = [each for each in self.asked if each[1] != unit]
        return count


def test_a_hole_costs_ten_requests_once_and_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, "libmodbus_py")
    plant = Plant()
    plant.missing[1] = {7}

    async def main() -> None:
        counts = []
        for _ in range(10):
            await asyncio.sleep(10)
            counts.append(plant.taken())
        assert counts[0] <= 1 + 10
        assert counts[1:] == [2] * 9
        poller = plant.fleet.devices["device 1"]
        assert poller.state is DeviceState.UP
        assert [each.name for each in poller.unreadable] == ["p7"]
        plant.missing.clear()
        await asyncio.sleep(700)
        assert poller.unreadable == []
        assert poller.error is None

    plant.run(main, plant.device(1))
    told = [(each.quality, each.reason) for each in plant.readings if each.name == "p7"]
    assert told[0] == ("bad", "IllegalDataAddress")
    assert set(told[1:]) == {("good", "")}
    others = [each for each in plant.readings if each.name != "p7"]
    assert all(each.quality == "good" and each.value == int(each.name[1:]) for each in others)
    assert caplog.messages == [
        "device 1: cannot be read: p7, holding_registers 7 (1 register): "
        "illegal data address (exception 2)"
    ]


def test_devices_of_one_map_do_not_share_what_they_lack() -> None:
    plant = Plant()
    plant.missing = {1: {3}, 2: {15}, 3: set(), 4: set(range(20))}

    async def main() -> None:
        await asyncio.sleep(100)
        found = {
            name: [each.name for each in poller.unreadable]
            for name, poller in plant.fleet.devices.items()
        }
        assert found == {
            "device 1": ["p3"],
            "device 2": ["p15"],
            "device 3": [],
            "device 4": [each.name for each in TWENTY],
        }
        assert plant.fleet.statistics.up == 4
        for unit in range(1, 5):
            plant.taken(unit)
        await asyncio.sleep(100)
        assert [plant.taken(unit) for unit in (3, 4)] == [10, 10]

    plant.run(main, *(plant.device(unit) for unit in range(1, 5)))


def test_a_device_that_is_silent_about_its_first_request_is_not_down() -> None:
    plant = Plant()
    plant.silent = {0}

    async def main() -> None:
        await asyncio.sleep(100)
        poller = plant.fleet.devices["device 1"]
        assert poller.state is DeviceState.UP
        assert plant.fleet.statistics.failures == 1
        plant.silent = set()
        await asyncio.sleep(20)
        assert poller.error is None

    plant.run(main, plant.device(1, APART))
    last = {each.name: (each.quality, each.value) for each in plant.readings}
    assert last == {"a": ("good", 0), "b": ("good", 10), "c": ("good", 20)}
    good = Counter(each.name for each in plant.readings if each.quality == "good")
    assert good["b"] == good["c"] >= 10


def test_a_device_that_is_gone_costs_one_request_a_trial() -> None:
    plant = Plant()
    plant.silent = set(range(100))

    async def main() -> None:
        await asyncio.sleep(1000)
        assert plant.fleet.devices["device 1"].state is DeviceState.DOWN
        assert len(plant.asked) == plant.fleet.statistics.polls
        assert len({each[2] for each in plant.asked}) == 3

    plant.run(main, plant.device(1, APART))


def test_a_device_that_leaves_while_it_is_searched() -> None:
    plant = Plant()
    plant.missing[1] = {7}

    async def main() -> None:
        while len(plant.asked) < 3:
            await asyncio.sleep(0.001)
        plant.silent = set(range(20))
        await asyncio.sleep(50)
        assert plant.fleet.devices["device 1"].state is DeviceState.DOWN
        assert plant.fleet.devices["device 1"].unreadable == []
        plant.silent = set()
        await asyncio.sleep(200)
        assert [each.name for each in plant.fleet.devices["device 1"].unreadable] == ["p7"]

    plant.run(main, plant.device(1))


def test_devices_that_are_replaced_while_they_are_searched() -> None:
    """Nothing of the search goes on, and what was learnt is true."""
    for stop in range(1, 8):
        plant = Plant()
        plant.missing = {1: {7}, 2: {7}}

        async def main(plant: Plant = plant, stop: int = stop) -> None:
            while len(plant.asked) < stop:
                await asyncio.sleep(0.001)
            plant.fleet.replace([plant.device(2)])
            asked = plant.taken(1)
            await asyncio.sleep(100)
            assert plant.taken(1) == 0
            assert asked <= stop
            plant.fleet.replace([plant.device(1), plant.device(2)])
            await asyncio.sleep(100)
            for poller in plant.fleet.devices.values():
                assert [each.name for each in poller.unreadable] == ["p7"]

        plant.run(main, plant.device(1))
