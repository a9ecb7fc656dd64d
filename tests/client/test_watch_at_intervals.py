"""
`watch` of points with intervals of their own, and of totals that fall.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import AsyncClient, Client, ModbusTimeoutError, Point, RegisterMap
from tests.simulation.network import Network
from tests.simulation.scripted import Scripted
from tests.support.peers import Write, mbap

H = "holding_registers"

METER = RegisterMap(
    [
        Point("v", H, 0),
        Point("energy", H, 10, interval=3, never_falls=True),
        Point("sf", H, 20, interval=3),
    ]
)


class Meter:
    """A simulated device whose registers a test sets, and a client that watches it."""

    def __init__(self, kind: str, network: Network, loop: asyncio.AbstractEventLoop) -> None:
        self.kind, self.network, self.loop = kind, network, loop
        self.registers: dict[int, list[int]] = {0: [230], 10: [100], 20: [1]}
        self.silent: set[int] = set()
        self.asked: list[tuple[float, int]] = []
        self.begun: float | None = None
        self.device = Scripted(network, "tcp://10.0.0.1", self.answer)

    def answer(self, request: bytes, write: Write) -> None:
        address = int.from_bytes(request[8:10], "big")
        if self.begun is None:
            self.begun = self.network.events.now
        self.asked.append((round(self.network.events.now - self.begun, 1), address))
        if address in self.silent:
            return
        values = self.registers[address]
        value = values.pop(0) if len(values) > 1 else values[0]
        write(mbap(request, b"\x03\x02" + value.to_bytes(2, "big")))

    def watch(self, most: int, what: Any = METER, **options: Any) -> list[Any]:
        if self.kind == "asyncio":
            return self.loop.run_until_complete(self._await(most, what, options))
        found = []
        with Client(self.device.url, native=False, timeout=0.2) as plc:
            for values in plc.watch(what, **options):
                found.append(values)
                if len(found) == most:
                    break
        return found

    async def _await(self, most: int, what: Any, options: Any) -> list[Any]:
        found = []
        async with AsyncClient(self.device.url, timeout=0.2, max_pause=0) as plc:
            async for values in plc.watch(what, **options):
                found.append(values)
                if len(found) == most:
                    break
        return found

    def times(self, address: int) -> list[int]:
        return [round(at) for at, asked in self.asked if asked == address]


@pytest.fixture(params=["blocking", "asyncio"])
def meter(request: pytest.FixtureRequest) -> Iterator[Meter]:
    network = Network()
    loop = network.loop()
    with network.installed():
        yield Meter(request.param, network, loop)
    assert not asyncio.all_tasks(loop)
    loop.close()


def test_points_are_asked_at_their_intervals_and_keep_their_values(meter: Meter) -> None:
    found = meter.watch(8, every=1)
    assert found == [{"v": 230, "energy": 100, "sf": 1}] * 8
    assert meter.times(0) == [0, 1, 2, 3, 4, 5, 6, 7]
    assert meter.times(10) == meter.times(20) == [0, 3, 6]


def test_polls_come_at_the_shortest_interval(meter: Meter) -> None:
    meter.watch(4, every=6)
    assert meter.times(10) == [0, 3, 6, 9]
    assert meter.times(0) == [0, 6]


def test_no_point_is_asked_sooner_than_its_interval(meter: Meter) -> None:
    points = RegisterMap([Point("v", H, 0), Point("energy", H, 10, interval=2.5)])
    meter.watch(8, points, every=1)
    assert meter.times(10) == [0, 3, 6]


def test_a_total_that_is_smaller_once_is_not_believed(meter: Meter) -> None:
    meter.registers[10] = [100, 3, 101, 102]
    found = meter.watch(7, every=1, names=["v", "energy"])
    assert [values["energy"] for values in found] == [100, 100, 100, 101, 101, 101, 102]
    assert not any(values.fell for values in found)
    assert meter.times(10) == [0, 3, 3, 6]


def test_a_total_that_is_smaller_twice_is_marked_once(meter: Meter) -> None:
    meter.registers[10] = [100, 3, 4, 5]
    found = meter.watch(7, every=1, names=["v", "energy"])
    assert [values["energy"] for values in found] == [100, 100, 100, 4, 4, 4, 5]
    assert [set(values.fell) for values in found] == [*[set()] * 3, {"energy"}, *[set()] * 3]


def test_a_point_without_an_answer_is_asked_again_at_the_next_poll_once(meter: Meter) -> None:
    meter.silent = {20}
    found = meter.watch(7, every=1)
    assert isinstance(found[0]["sf"], ModbusTimeoutError)
    # Each time-out takes some of the next second; a connection that failed at once is tried twice.
    assert sorted(set(meter.times(20))) == [0, 1, 4, 5]
