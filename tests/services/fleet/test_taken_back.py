"""
Values of what is not polled any more are taken back: each point is reported "offline" once, and
metrics forget it.
"""

from collections.abc import Sequence
from dataclasses import replace

from libmodbus_py import Fleet
from libmodbus_py.fleet import Reading
from tests.services.fleet.fleets import Peer, good, in_simulated_time, meter, polling, silent, until

OFFLINE = [("voltage", None, "V"), ("power", None, "W"), ("setpoint", None, "C")]


def offline(readings: Sequence[Reading], device: str) -> list[tuple[str, object, str]]:
    """The points of a device that were taken back, and that none was reported behind that."""
    own = [reading for reading in readings if reading.device == device]
    first = next((at for at, reading in enumerate(own) if reading.quality == "offline"), len(own))
    assert all(reading.quality == "offline" for reading in own[first:])
    return [(entry.name, entry.value, entry.units) for entry in own[first:]]


@in_simulated_time
async def test_a_removed_point_is_reported_offline_once() -> None:
    async with Peer() as peer:
        devices = [meter(name, peer.url, unit=unit) for unit, name in enumerate("ab", 1)]
        async with polling(*devices) as (fleet, readings):
            await until(lambda: fleet.statistics.up == 2)
            fleet.replace(devices[:1])
            before = fleet.statistics.polls
            await until(lambda: fleet.statistics.polls > before + 3)
            assert offline(readings, "b") == OFFLINE
            assert offline(readings, "a") == []
            fleet.remove(devices[0].connection_key)
            await until(lambda: offline(readings, "a") == OFFLINE)


@in_simulated_time
async def test_of_a_changed_device_only_the_removed_points_are_reported_offline() -> None:
    async with Peer() as peer, polling(meter("a", peer.url)) as (fleet, readings):
        await until(lambda: fleet.statistics.up)
        fleet.replace([meter("a", peer.url, items=("power",), interval=0.2)])
        polls = fleet.statistics.polls
        await until(lambda: fleet.statistics.polls > polls + 1)
        names = [reading.name for reading in readings if reading.quality == "offline"]
        assert names == ["voltage", "setpoint"]
        assert readings[-1][2:6] == ("power", 7, "W", "good")


@in_simulated_time
async def test_a_point_that_was_never_reported_is_not_reported_offline() -> None:
    async with Peer(silent) as peer:
        async with polling(meter("a", f"{peer.url}?timeout=60")) as (fleet, readings):
            await until(lambda: peer.requests)
            fleet.replace([])
        assert readings == []


@in_simulated_time
async def test_a_device_removed_before_its_first_poll_after_a_change_is_reported_offline() -> None:
    async with Peer() as peer:
        device = meter("a", peer.url)
        async with polling(device) as (fleet, readings):
            await until(lambda: fleet.statistics.up)
            fleet.replace([replace(device, interval=3600)])
            fleet.replace([replace(device, interval=1800)])
            fleet.replace([])
        assert offline(readings, "a") == OFFLINE


@in_simulated_time
async def test_a_point_that_another_fleet_polls_now_is_not_reported_offline() -> None:
    async with Peer() as peer:
        device = meter("a", peer.url)
        async with polling(device) as (fleet, readings):
            await until(lambda: fleet.statistics.up)
            fleet.replace([], passed_on={device.connection_key})
        assert {reading.quality for reading in readings} == {"good"}


@in_simulated_time
async def test_values_reported_offline_are_reported_again_though_they_did_not_change() -> None:
    may_ask = True

    async with Peer() as peer:
        device = meter("a", peer.url, on_change=True)
        async with polling(device, may_ask=lambda key: may_ask) as (fleet, readings):
            await until(lambda: fleet.statistics.up)
            may_ask = False
            fleet.take_back()
            fleet.take_back()
            assert fleet.statistics.up == 0
            held = fleet.statistics.vetoes
            await until(lambda: fleet.statistics.vetoes > held + 3)
            assert offline(readings, "a") == OFFLINE
            may_ask = True
            await until(lambda: len(readings) == 9)
            assert fleet.statistics.up == 1
            assert [reading.quality for reading in readings[6:]] == 3 * ["good"]


@in_simulated_time
async def test_last_values_of_removed_devices_are_removed() -> None:
    def last() -> set[tuple[str, str]]:
        pollers = fleet.devices.values()
        return {(poller.name, point.name) for poller in pollers for point in poller.last_values()}

    async with Peer(good) as peer:
        devices = [meter(name, peer.url, unit=unit) for unit, name in enumerate("ab", 1)]
        async with Fleet(devices) as fleet:
            await until(lambda: len(last()) == 6)
            fleet.replace([devices[0]])
            assert {device for device, _ in last()} == {"a"}
            fleet.replace([meter("a", peer.url, items=("power",))])
            await until(lambda: last() == {("a", "power")})
            fleet.take_back()
            assert last() == set()
