"""Devices that flood, trickle, double and answer late; clocks, forks, cancellations."""

import asyncio
import os
import tracemalloc
from typing import Any

import pytest

from libmodbus_py import Fleet
from libmodbus_py.fleet import Output, Reading
from libmodbus_py.services.fleet import fleet as fleets
from tests.services.fleet.fleets import (
    NETWORK,
    Peer,
    good,
    in_simulated_time,
    meter,
    polling,
    real_peer,
    silent,
    until,
)


async def flooding(request: bytes) -> bytes:
    return await good(request) + b"\0\1\0\0\0\3\7\x83\2" * 10_000


async def doubled(request: bytes) -> bytes:
    return 2 * await good(request)


async def garbage(request: bytes) -> bytes:
    return b"\xff" * 300


async def of_another(request: bytes) -> bytes:
    answer = await good(request)
    return answer[:6] + bytes([answer[6] ^ 0x40]) + answer[7:]


async def short(request: bytes) -> bytes:
    return (await good(request))[:-1]


async def late(request: bytes) -> bytes:
    await asyncio.sleep(0.15)
    return await good(request)


@pytest.mark.parametrize(
    "manners",
    [flooding, doubled, garbage, of_another, short, late, silent],
    ids=lambda f: f.__name__,
)
@in_simulated_time
async def test_a_misbehaving_device_does_not_affect_others(manners: Any) -> None:
    async with Peer(manners) as bad, Peer() as well:
        devices = [
            meter("bad", f"{bad.url}?timeout=0.1&max_pause=0.1"),
            *(meter(f"good {unit}", well.url, unit=unit) for unit in range(1, 6)),
        ]
        async with polling(*devices) as (fleet, readings):
            await until(lambda: len(bad.requests) >= 3 and len(well.requests) >= 25)
            # No damaged answer is taken for a value.
            values = {reading[2:6] for reading in readings if reading.quality == "good"}
            assert values == {
                ("voltage", 0.7, "V", "good"),
                ("power", 7, "W", "good"),
                ("setpoint", 7, "C", "good"),
            }
            assert all(
                device.state.value == "up" and device.misses == 0
                for device in fleet.devices.values()
                if device.name != "bad"
            )


@in_simulated_time
async def test_setting_the_clock_shifts_no_poll(monkeypatch: pytest.MonkeyPatch) -> None:
    network = NETWORK.get()
    now = network.time_of_day
    async with Peer() as peer:
        devices = [meter(f"{unit}", peer.url, unit=unit) for unit in range(1, 6)]
        async with polling(*devices) as (fleet, readings):
            await until(lambda: fleet.statistics.polls > 10)
            for shift in (-1e6, 1e6):
                monkeypatch.setattr(fleets.time, "time", lambda shift=shift: now() + shift)
                before = fleet.statistics.polls
                await asyncio.sleep(1.0)
                assert 49 <= fleet.statistics.polls - before <= 51
                assert 0 <= now() + shift - readings[-1].time < 0.1
        assert fleet.statistics.skipped == 0


@pytest.mark.parametrize("turns", [*range(0, 30, 3), 60, 100])
@in_simulated_time
async def test_run_may_be_cancelled_at_any_time(turns: int) -> None:
    """After so many turns of the loop: nothing is left, neither tasks nor connections."""
    async with Peer() as peer:
        devices = [meter(f"{unit}", peer.url, unit=unit, interval=0.01) for unit in range(1, 9)]
        before = asyncio.all_tasks()
        fleet = Fleet([*devices, meter("gone", "tcp://127.0.0.1:1")])
        running = asyncio.create_task(fleet.run())
        for _ in range(turns):
            await asyncio.sleep(0)
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
        count = len(peer.requests)
        await asyncio.sleep(0.05)
        assert len(peer.requests) <= count + 8  # what was on its way
        assert asyncio.all_tasks() - before - peer._tasks == set()
        async with fleet:  # it can be run again
            await until(lambda: fleet.statistics.up == 8)


async def test_a_fork_does_not_affect_the_parent() -> None:
    async with real_peer() as peer:
        devices = [meter(f"{unit}", peer.url, unit=unit) for unit in range(1, 6)]
        async with polling(*devices) as (fleet, _):
            await until(lambda: fleet.statistics.up == 5)
            child = os.fork()
            if not child:
                os._exit(0)
            assert os.waitpid(child, 0)[1] == 0
            polls = fleet.statistics.polls
            await until(lambda: fleet.statistics.polls > polls + 10)
            assert peer.connections == 1
            assert fleet.statistics.failures == 0


@in_simulated_time
async def test_an_output_may_add_and_remove_devices_in_its_callback() -> None:
    """Whoever sees a reading may change the fleet at once."""
    async with Peer() as one, Peer() as two:
        fleet = Fleet([meter("a", one.url)])

        class Changing(Output):
            name = "changing"

            async def write_readings(self, readings: list[Reading]) -> None:
                if readings:
                    url = two.url if readings[0].device == "a" else one.url
                    fleet.replace([meter("b" if url == two.url else "a", url)])

        fleet._receivers.outputs.append(Changing())
        async with fleet:
            await until(lambda: len(one.connections) > 5 and len(two.connections) > 5)
        assert len(fleet.devices) == 0


@in_simulated_time
async def test_memory_for_a_device_is_small() -> None:
    """25 KiB are promised with its share of a connection; this is without connecting."""
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        devices = [
            meter(f"{at}", f"tcp://127.0.0.1:{at // 10 + 1}", unit=at % 10 + 1, interval=3600)
            for at in range(1000)
        ]
        async with Fleet(devices):
            assert (tracemalloc.get_traced_memory()[0] - before) / 1000 < 12_000
    finally:
        tracemalloc.stop()
