"""Fleets that poll: who shares a connection, who is down, what is skipped, what changes."""

import asyncio
import gc
import weakref
from collections import Counter
from dataclasses import replace

import pytest

from libmodbus_py import Device, Fleet, Mapping, Point, RegisterMap, Server
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.services.fleet.poller import FleetLine, Poller
from libmodbus_py.tools.testing.wires import SerialWire
from tests.services.fleet.fleets import (
    NETWORK,
    Peer,
    good,
    in_simulated_time,
    meter,
    polling,
    silent,
    simulated,
    stand_still,
    until,
)
from tests.support.outputs import FakeOutput


@in_simulated_time
async def test_readings_have_names_and_scaled_values_and_times() -> None:
    time_of_day = NETWORK.get().time_of_day
    before = time_of_day()
    async with (
        Server({1: simulated(2305), 2: simulated(100)}).serving("tcp://127.0.0.1:0") as running,
        polling(
            meter("a", running.urls[0]), meter("b", running.urls[0], unit=2, items=("voltage",))
        ) as (fleet, readings),
    ):
        await until(lambda: len(readings) > 20)
        a = [reading for reading in readings if reading.device == "a"]
        assert [row[2:7] for row in a[:3]] == [
            ("voltage", 230.5, "V", "good", ""),
            ("power", -1, "W", "good", ""),
            ("setpoint", 20, "C", "good", ""),
        ]
        assert {item[2:4] for item in readings if item.device == "b"} == {("voltage", 10.0)}
        assert all(before <= reading.time <= time_of_day() for reading in readings)
        assert (fleet.statistics.devices, fleet.statistics.up) == (2, 2)
        assert fleet.statistics.readings >= len(readings)
    assert [device.state for device in fleet.devices.values()] == []


async def even(request: bytes) -> bytes | None:
    return await good(request) if request[6] % 2 == 0 else None


@in_simulated_time
async def test_fifty_silent_units_on_a_gateway_do_not_delay_the_others() -> None:
    async with Peer(even) as peer:
        url = f"{peer.url}?timeout=0.3"
        devices = [meter(f"{unit}", url, unit=unit, interval=0.2) for unit in range(1, 101)]
        async with polling(*devices) as (fleet, readings):
            await until(lambda: fleet.statistics.down == 50 and fleet.statistics.up == 50)
            peer.requests.clear()
            alive = range(2, 101, 2)
            await until(lambda: min(map(Counter(peer.units).__getitem__, alive)) >= 6)
            # A timeout for each try of the dead at each interval would be as many for them.
            dead = [unit for unit in peer.units if unit % 2]
            assert len(dead) < len(peer.units) / 3
        # Each point of a silent device was reported once.
        down = Counter((item.device, item.name) for item in readings if item.quality == "down")
        of_the_dead = [count for (unit, _), count in down.items() if int(unit) % 2]
        assert of_the_dead == [1] * 150


async def test_devices_on_real_connections_are_polled() -> None:
    """Over TCP, and on a line without one of the units."""
    with SerialWire() as wire:
        units = {1: simulated(100), 3: simulated(300)}
        line = f"rtu://{wire.client}?timeout=0.5"
        async with (
            Server(units).serving(f"rtu://{wire.server}", "tcp://127.0.0.1:0") as running,
            polling(
                *(meter(f"{unit}", line, unit=unit, interval=0.2) for unit in (1, 2, 3)),
                meter("tcp", running.urls[1], unit=3),
            ) as (fleet, readings),
        ):
            await until(lambda: fleet.statistics.up == 3 and fleet.statistics.down == 1)
            await fleet.write("1", {"setpoint": 25})
            await until(lambda: readings[-1].value == 25)
        values = {reading[1:4] for reading in readings if reading.name == "voltage"}
        assert values == {
            ("1", "voltage", 10.0),
            ("2", "voltage", None),
            ("3", "voltage", 30.0),
            ("tcp", "voltage", 30.0),
        }


@in_simulated_time
async def test_polls_missed_by_a_blocked_loop_are_skipped_and_counted() -> None:
    async with Peer() as peer:
        devices = [meter(f"{unit}", peer.url, unit=unit) for unit in range(1, 11)]
        async with polling(*devices) as (fleet, _):
            await until(lambda: fleet.statistics.polls >= 10)
            before, polls = fleet.statistics.skipped, fleet.statistics.polls
            stand_still(1.0)
            await until(lambda: fleet.statistics.polls >= polls + 10)
            # Ten devices each missed nine or ten, and are polled once for all of them.
            assert 60 <= fleet.statistics.skipped - before <= 200
            assert fleet.statistics.take_worst() > 0.5


@in_simulated_time
async def test_each_device_has_its_own_timeout() -> None:
    async with Peer(silent) as peer:
        fast = meter("fast", f"{peer.url}?timeout=5&max_in_flight=2", unit=1, timeout=0.05)
        slow = meter("slow", f"{peer.url}?timeout=5&max_in_flight=2", unit=2)
        async with polling(fast, slow) as (fleet, _):
            await until(lambda: fleet.devices["fast"].misses >= 2)
            assert fleet.devices["slow"].misses == 0


@in_simulated_time
async def test_polls_due_after_a_standstill_begin_in_many_turns_of_the_loop(monkeypatch) -> None:
    """Nothing else would happen for half a second, if thousands of polls began in one turn."""
    began: Counter[int] = Counter()
    turn = 0

    def due(line: FleetLine, poller: Poller, planned: float) -> None:
        began[turn] += 1

    monkeypatch.setattr(FleetLine, "due", due)
    url = "tcp://127.0.0.1:1"
    async with polling(*(meter(f"{number}", url, interval=1.0) for number in range(1000))):
        stand_still(1.0)
        while began.total() < 1000:
            turn += 1
            await asyncio.sleep(0)
    assert max(began.values()) == 200


@in_simulated_time
async def test_once_polls_each_device_once_and_ends() -> None:
    async with Peer(even) as peer:
        url = f"{peer.url}?timeout=0.1&max_in_flight=16"
        fleet = Fleet(meter(f"{unit}", url, unit=unit, interval=60) for unit in range(1, 11))
        iterator = fleet.readings()
        await fleet.run(once=True)
        assert sorted(peer.units) == list(range(1, 11))
        assert fleet.statistics.polls == 10
        assert fleet.statistics.failures == 5
        readings = [reading async for reading in iterator]
        assert Counter(reading.quality for reading in readings) == {"good": 15, "down": 15}
        assert {reading.id for reading in readings} == {0}  # there is no journal
        await Fleet().run(once=True)


@pytest.mark.parametrize("is_replaced", [False, True])
@in_simulated_time
async def test_once_ends_when_the_last_device_without_a_poll_is_removed(is_replaced: bool) -> None:
    async with Peer(even) as peer:
        silent = meter("silent", f"{peer.url}?timeout=50", unit=1)
        good = meter("good", f"{peer.url}?timeout=50", unit=2)
        fleet = Fleet([silent, good])
        polling = asyncio.create_task(fleet.run(once=True))
        await until(lambda: {1, 2} <= set(peer.units))
        fleet.replace([replace(good, name="other")] if is_replaced else [good])
        async with asyncio.timeout(40):
            await polling
        assert peer.units.count(2) == 1 + is_replaced


@in_simulated_time
async def test_replace_touches_only_changed_devices() -> None:
    async with Peer() as one, Peer() as two, Peer() as three:
        a, b = meter("a", one.url, unit=1), meter("b", one.url, unit=2)
        c = meter("c", two.url)
        async with polling(a, b, c) as (fleet, _):
            await until(lambda: fleet.statistics.up == 3)
            same = fleet.devices["a"]
            changed = meter("b", one.url, unit=3)
            fleet.replace([a, changed, meter("d", three.url)])
            assert fleet.devices["a"] is same
            assert set(fleet.devices) == {"a", "b", "d"}
            await until(lambda: 3 in one.units and three.requests)
            assert len(one.connections) == 1
            await until(lambda: two.connections[0].is_closed)
            two.requests.clear()
            one.requests.clear()
            await until(lambda: len(one.requests) > 10)
            assert 2 not in one.units
            assert two.requests == []
            assert fleet.statistics.devices == 3
            await until(lambda: fleet.statistics.up == 3)


@in_simulated_time
async def test_replaced_devices_are_freed_before_their_next_poll() -> None:
    async with Peer() as peer, polling(meter("a", peer.url, interval=86_400.0)) as (fleet, _):
        former = weakref.ref(fleet.devices["a"])
        fleet.replace([meter("a", peer.url, interval=86_400.0, unit=2)])

        def is_gone() -> bool:
            gc.collect()
            return former() is None

        await until(is_gone)


@in_simulated_time
async def test_no_plan_remains_while_outputs_end() -> None:
    class Slow(FakeOutput):
        async def close_output(self) -> None:
            await asyncio.sleep(5)

    async with Peer() as peer, polling(meter("a", peer.url), outputs=[Slow()]) as (fleet, _):
        await until(lambda: fleet.statistics.polls >= 2)


@in_simulated_time
async def test_a_wrong_list_of_devices_changes_nothing() -> None:
    async with Peer() as peer, polling(meter("a", peer.url)) as (fleet, _):
        before = fleet.devices["a"]
        for bad, text in (
            (meter("a", peer.url, unit=5), "'a' is also the name of another"),
            (meter("b", f"{peer.url}?timeout=3", unit=5), "has other options for"),
        ):
            with pytest.raises(ValueError, match=text):
                fleet.add([bad])
        with pytest.raises(ValueError, match="'a' is also the name of"):
            fleet.replace([meter("a", peer.url), meter("a", peer.url, unit=2)])
        with pytest.raises(TypeError, match=r"devices\[0\] must be a DeviceConfig, not str"):
            fleet.replace(["a"])  # type: ignore[list-item]
        assert fleet.devices == {"a": before}
        with pytest.raises(RuntimeError, match="already polling"):
            await fleet.run()
        await until(lambda: fleet.statistics.up == 1)
        assert {*peer.units} == {1}


@in_simulated_time
async def test_a_device_that_may_not_be_asked_is_not_polled_and_gives_no_reading() -> None:
    names: set[str] = set()
    async with Peer() as one, Peer() as two:
        devices = [meter("one", one.url), meter("two", two.url)]
        keys = [device.connection_key for device in devices]
        async with polling(*devices, may_ask=lambda key: key in names) as (fleet, readings):
            await until(lambda: fleet.statistics.vetoes >= 4)
            assert one.connections == two.connections == readings == []
            names.add(keys[0])
            await until(lambda: len(readings) > 6)
            assert {reading.device for reading in readings} == {"one"}
            assert two.connections == []
            names.clear()
            await asyncio.sleep(0.05)
            count, held = len(one.requests), fleet.statistics.vetoes
            await until(lambda: fleet.statistics.vetoes >= held + 6)
            assert len(one.requests) == count
            # The device is not counted as down, because it was not asked.
            assert fleet.statistics.down == 0
            assert {reading.quality for reading in readings} == {"good"}


@in_simulated_time
async def test_the_last_value_of_a_point_is_written_again_until_the_next(caplog) -> None:
    period = 30
    points = [Point("power", "holding_registers", 2, rewrite=period, maximum=100)]
    device = Device(Mapping(holding_registers=range(4)))
    registers = device.mapping.holding_registers
    async with Server({1: device}).serving("tcp://127.0.0.1:0") as running:
        config = DeviceConfig("a", running.urls[0], RegisterMap(points), interval=1000)
        async with polling(config) as (fleet, _):
            await fleet.write("a", {"power": 50})
            for _ in range(2):  # the watchdog of the device falls back
                registers[2] = 0
                await asyncio.sleep(period - 1)
                assert registers[2] == 0
                await asyncio.sleep(period / 15)
                assert registers[2] == 50
            with pytest.raises(ValueError, match="100"):
                await fleet.write("a", {"power": 101})
            registers[2] = 0
            await asyncio.sleep(period + 1)
            assert registers[2] == 50
            await fleet.write("a", {"power": 60})
            registers[2] = 0
            await asyncio.sleep(period + 1)
            assert registers[2] == 60
        registers[2] = 0
        await asyncio.sleep(3 * period)
        assert registers[2] == 0
    assert caplog.records == []


@in_simulated_time
async def test_a_write_by_name_reaches_the_device() -> None:
    device = simulated()
    async with (
        Server({1: device}).serving("tcp://127.0.0.1:0") as running,
        polling(meter("a", running.urls[0])) as (fleet, readings),
    ):
        await fleet.write("a", {"setpoint": 25})
        assert device.mapping.holding_registers[2] == 25
        await until(lambda: readings and readings[-1].value == 25)
        for bad, text in (({"setpoint": 31}, "10..30"), ({"voltage": 1}, "access is read")):
            with pytest.raises(ValueError, match=text):
                await fleet.write("a", bad)
        with pytest.raises(ValueError, match="no point 'nothing'"):
            await fleet.write("a", {"nothing": 1})
        with pytest.raises(KeyError):
            await fleet.write("b", {"setpoint": 25})
        assert device.mapping.holding_registers[2] == 25
