"""Polls that follow writes, and the function that writes."""

import asyncio
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from libmodbus_py import (
    Client,
    Device,
    Fleet,
    IllegalDataValue,
    IllegalFunction,
    Mapping,
    Point,
    RegisterMap,
    Server,
    pdu,
)
from libmodbus_py.fleet import DeviceConfig, Reading
from tests.services.fleet.fleets import Peer, in_simulated_time, meter, polling, until

POINTS = RegisterMap(
    [
        Point("setpoint", "holding_registers", 0),
        Point("limit", "holding_registers", 1, interval=86_400),
        Point("start", "holding_registers", 2, access="write"),
    ]
)

PAUSE = 1.0  # simulated seconds, after which a poll that follows a write is over


class Memory:
    """A device with a few registers, which takes `delay` for each answer."""

    def __init__(self, delay: float = 0.001) -> None:
        self.cells = [0, 0, 0]
        self.reads: list[tuple[int, int]] = []
        self.delay = delay
        self.is_refusing = False

    async def answer(self, request: bytes) -> bytes:
        function, address, value = struct.unpack(">BHH", request[7:12])
        if function == 3:
            self.reads.append((address, value))
            body = struct.pack(f">BB{value}H", 3, 2 * value, *self.cells[address:][:value])
        elif self.is_refusing:
            body = bytes([function | 0x80, 3])
        else:
            self.cells[address] = value
            body = request[7:12]
        await asyncio.sleep(self.delay)
        return request[:4] + struct.pack(">HB", 1 + len(body), request[6]) + body


@asynccontextmanager
async def polled(memory: Memory, **options: object) -> AsyncIterator[tuple[Fleet, list[Reading]]]:
    """Poll the device each minute; yield after the first poll."""
    async with Peer(memory.answer) as peer:
        keys = {"map": POINTS, "interval": 60, "on_change": True, **options}
        config: DeviceConfig = meter("a", peer.url, **keys)
        async with polling(config) as (fleet, readings):
            await until(lambda: len(readings) >= 2)
            memory.reads.clear()
            readings.clear()
            yield fleet, readings


def reported(readings: list[Reading]) -> list[tuple[str, object]]:
    return [(reading.name, reading.value) for reading in readings]


@in_simulated_time
async def test_a_written_value_is_reported_at_once() -> None:
    memory = Memory()
    async with polled(memory) as (fleet, readings):
        await fleet.write("a", {"setpoint": 21})
        await asyncio.sleep(PAUSE)
        assert reported(readings) == [("setpoint", 21)]
        assert memory.reads == [(0, 1)]
        # Also a value within the dead band, an unchanged one, and one that is rarely read.
        await fleet.write("a", {"setpoint": 21})
        await fleet.write("a", {"limit": 7})
        await asyncio.sleep(PAUSE)
        assert sorted(reported(readings)[1:]) == [("limit", 7), ("setpoint", 21)]
        assert memory.reads[1:] == [(0, 2)]


@in_simulated_time
async def test_the_poll_after_a_write_shifts_no_other_poll() -> None:
    memory = Memory()
    async with polled(memory, interval=10) as (fleet, _):
        planned = fleet.devices["a"].at
        await fleet.write("a", {"setpoint": 1})
        await asyncio.sleep(PAUSE)
        assert fleet.devices["a"].at == planned
        assert (fleet.statistics.polls, fleet.statistics.skipped) == (2, 0)


async def one_by_one(fleet: Fleet) -> None:
    for value in range(30):
        await fleet.write("a", {"setpoint": value})


async def at_once(fleet: Fleet) -> None:
    await asyncio.gather(*[fleet.write("a", {"setpoint": value}) for value in range(30)])


async def as_commands(fleet: Fleet) -> None:
    commands = [fleet.commands.answer("a", "setpoint", b"%d" % value) for value in range(30)]
    await asyncio.gather(*commands)


async def with_wrong_ones(fleet: Fleet) -> None:
    await as_commands(fleet)
    for command in (b"70000", b"on", b"{"):
        await fleet.commands.answer("a", "setpoint", command)


@pytest.mark.parametrize("delay", [0.001, 0.2])
@pytest.mark.parametrize("write", [one_by_one, at_once, as_commands, with_wrong_ones])
@in_simulated_time
async def test_many_writes_in_a_row_cost_one_poll(write, delay) -> None:
    memory = Memory(delay)
    async with polled(memory) as (fleet, readings):
        await write(fleet)
        await asyncio.sleep(PAUSE)
        assert reported(readings) == [("setpoint", 29)]
        assert len(memory.reads) == 1


@in_simulated_time
async def test_a_poll_under_way_during_a_write_is_followed_by_another() -> None:
    """It may have read the point before it was written."""
    memory = Memory()
    async with polled(memory, interval=10) as (fleet, readings):
        memory.delay = 0.3
        await until(lambda: memory.reads)
        memory.delay = 0.001
        await fleet.write("a", {"setpoint": 5})
        await until(lambda: readings)
        await asyncio.sleep(PAUSE)
        assert reported(readings)[-1] == ("setpoint", 5)
        assert len(memory.reads) == 2


@in_simulated_time
async def test_writes_that_fail_are_followed_by_no_poll() -> None:
    memory = Memory()
    async with polled(memory) as (fleet, _):
        memory.is_refusing = True
        with pytest.raises(IllegalDataValue):
            await fleet.write("a", {"setpoint": 5})
        with pytest.raises(ValueError, match="setpoint"):
            await fleet.write("a", {"setpoint": 70_000})
        await asyncio.sleep(PAUSE)
        assert not memory.reads


@in_simulated_time
async def test_a_device_that_was_removed_after_a_write_is_not_polled() -> None:
    memory = Memory()
    async with polled(memory) as (fleet, _):
        await fleet.write("a", {"setpoint": 5})
        fleet.replace([])
        await asyncio.sleep(PAUSE)
        assert not memory.reads


@in_simulated_time
async def test_a_point_that_cannot_be_read_causes_a_poll_of_the_others() -> None:
    memory = Memory()
    async with polled(memory) as (fleet, readings):
        memory.cells[0] = 9
        await fleet.write("a", {"start": 1})
        await asyncio.sleep(PAUSE)
        assert reported(readings) == [("setpoint", 9)]


@pytest.mark.parametrize("place", ["device", "url", "point"])
def test_a_fleet_writes_to_a_device_without_function_6(place: str) -> None:
    """The function is that of the point, of the device or of the URL."""
    requests: list[Any] = []

    def refuse(request: Any) -> None:
        requests.append(request)
        raise IllegalFunction

    mapping = Mapping(holding_registers=10)
    device = Device(mapping, handlers={pdu.WriteRegister: refuse})
    keys: Any = {"write_function": "multiple"}
    points = RegisterMap([Point("it", "holding_registers", 3, **keys if place == "point" else {})])

    async def write(url: str) -> None:
        config = DeviceConfig("pump", url, points, **keys if place == "device" else {})
        async with Fleet([config]) as fleet:
            await fleet.write("pump", {"it": 9})

    with Server(device).background("tcp://127.0.0.1:0") as running:
        url = running.urls[0]
        asyncio.run(write(f"{url}?write_function=multiple" if place == "url" else url))
        with Client(url) as plc:
            assert plc.read_holding_registers(3, 1) == [9]
    assert not requests
