"""Devices that share a line, in simulated time: whose poll is next, and what a silent one costs."""

import asyncio
from itertools import pairwise

import pytest

from libmodbus_py import Fleet, Point, RegisterMap
from libmodbus_py.services import line as shared_line
from libmodbus_py.services.fleet.fleet import first_time
from libmodbus_py.services.fleet.poller import DeviceState
from tests.services.fleet.fleets import in_simulated_time
from tests.simulation.plants import MAP, Plant


def gaps(times: list[float]) -> list[float]:
    return [round(after - before, 3) for before, after in pairwise(times)]


@in_simulated_time
async def test_each_device_is_polled_at_its_interval() -> None:
    plant = Plant()
    async with plant.polls(plant.device(1), plant.device(2, interval=2.0)):
        await asyncio.sleep(10)
        assert len(plant.times(1)) in (10, 11)
        assert len(plant.times(2)) in (5, 6)
        assert set(gaps(plant.times(1))) <= {0.999, 1.0, 1.001}
        statistics = plant.fleet.statistics
        assert (statistics.devices, statistics.up, statistics.down) == (2, 2, 0)
        assert (statistics.skipped, statistics.failures, statistics.vetoes) == (0, 0, 0)
        assert statistics.polls == statistics.readings
        # One request may be in flight.
        assert len(plant.asked) - statistics.polls in (0, 1)


@in_simulated_time
async def test_a_device_is_polled_at_the_same_time_of_day_on_each_machine() -> None:
    plant = Plant()
    async with plant.polls(plant.device(1, interval=7.0)):
        await asyncio.sleep(30)
        wall = plant.network.time_of_day() - plant.now
        phase = first_time("device 1", 7.0, 0.0, 0.0)
        assert plant.times(1)
        for at in plant.times(1):
            assert (at + wall) % 7.0 == pytest.approx(phase, abs=0.01)


@in_simulated_time
async def test_the_requests_of_a_poll_are_sent_one_after_the_other() -> None:
    """The values of a poll should belong together: no other device is asked in between."""
    plant = Plant()
    # They are due at the same time, for an interval so short puts them close together.
    async with plant.polls(*(plant.device(unit, MAP, interval=0.25) for unit in (1, 2, 3))):
        await asyncio.sleep(10)
        polls = plant.asked[: len(plant.asked) // 2 * 2]
        assert len(polls) >= 30
        for first, second in zip(polls[::2], polls[1::2], strict=True):
            assert (first[1:], second[1:]) == ((first[1], 0), (first[1], 9))


@in_simulated_time
async def test_intervals_of_points_count_from_when_polls_are_due() -> None:
    """A poll waits while its line is busy; the one after three seconds may wait less."""
    points = RegisterMap(
        [Point("near", "holding_registers", 0), Point("far", "holding_registers", 9, interval=3)]
    )
    plant = Plant()
    async with plant.polls(plant.device(1, points), plant.device(2, interval=0.7)):
        plant.delays[2] = 0.4
        await asyncio.sleep(90)
        far = [at for at, unit, address in plant.asked if (unit, address) == (1, 9)]
        assert {round(gap) for gap in gaps(far)} == {3}
        assert max(gaps(far)) > 3.1


@in_simulated_time
async def test_a_device_has_its_spacing_while_others_are_asked() -> None:
    plant = Plant()
    async with plant.polls(plant.device(1, MAP, spacing=0.3), plant.device(2, interval=0.1)):
        await asyncio.sleep(20)
        times = plant.times(1)
        assert min(gaps(times)) >= 0.3 + plant.delay - 0.01
        assert len(times) > 20
        others = set(gaps(plant.times(2)))
        assert others
        assert max(others) < 0.2


@in_simulated_time
async def test_a_device_has_its_spacing_between_polls() -> None:
    plant = Plant()
    async with plant.polls(plant.device(1, spacing=0.6, interval=0.5)):
        await asyncio.sleep(20)
        assert len(plant.times(1)) > 25
        assert min(gaps(plant.times(1))) >= 0.6 + plant.delay - 0.01


@in_simulated_time
async def test_a_damaged_answer_delays_only_its_device_for_a_timeout() -> None:
    plant = Plant(options="?timeout=2")
    async with plant.polls(plant.device(1, MAP), plant.device(2, interval=0.1)):
        plant.damaging.add(1)
        await asyncio.sleep(60)
        assert min(gaps(plant.times(1))) >= 2.0
        assert len(plant.times(1)) >= 15
        assert max(gaps(plant.times(2))) < 0.2


class TestSilentDevices:
    @in_simulated_time
    async def test_a_silent_device_is_polled_after_a_longer_pause_each_time(self) -> None:
        plant = Plant()
        async with plant.polls(plant.device(1)):
            plant.silent.add(1)
            await asyncio.sleep(200)
            pauses = gaps(plant.times(1))
            assert [round(pause) for pause in pauses[:6]] == [2, 3, 5, 9, 17, 33]
            assert max(pauses) < 65
            poller = plant.fleet.devices["device 1"]
            assert poller.state is DeviceState.DOWN
            statistics = plant.fleet.statistics
            assert (statistics.up, statistics.down) == (0, 1)
            assert statistics.failures == statistics.polls
            assert {reading.quality for reading in plant.readings} == {"down"}
            plant.silent.clear()
            await asyncio.sleep(65)
            assert poller.state is DeviceState.UP
            assert (statistics.up, statistics.down) == (1, 0)
            # The device is polled at its interval again.
            await asyncio.sleep(5)
            assert gaps(plant.times(1))[-3:] == [1.0, 1.0, 1.0]

    @in_simulated_time
    async def test_a_trial_of_a_silent_device_waits_for_other_polls(self) -> None:
        """The trial costs others no more than one of their own answers takes."""
        plant = Plant()
        async with plant.polls(plant.device(9), plant.device(1, interval=0.1)):
            plant.silent.add(9)
            await asyncio.sleep(60)
            before = plant.fleet.statistics.skipped
            start = plant.now
            await asyncio.sleep(30)
            since = [at for at in plant.times(1) if at >= start]
            assert len(since) > 250
            assert max(gaps(since)) < 0.25
            assert plant.fleet.statistics.skipped - before < 5
            assert len(plant.times(9)) >= 4

    @in_simulated_time
    async def test_some_polls_of_a_silent_device_wait_for_the_whole_timeout(self, monkeypatch):
        """The device may have become slower than all others, and would never be found."""
        monkeypatch.setattr(shared_line, "TRIALS_BEFORE_LONG", 6)
        plant = Plant()
        async with plant.polls(plant.device(9), plant.device(1, interval=0.1)):
            plant.silent.add(9)
            await asyncio.sleep(10)
            plant.silent.clear()
            plant.delays[9] = 0.4
            while plant.fleet.devices["device 9"].state is not DeviceState.UP:
                await asyncio.sleep(0.1)
                assert len(plant.times(9)) <= 7
            assert len(plant.times(9)) == 7

    @in_simulated_time
    async def test_a_trial_does_not_wait_for_a_device_in_its_spacing(self) -> None:
        plant = Plant()
        async with plant.polls(plant.device(9), plant.device(1, spacing=3.0)):
            plant.silent.add(9)
            await asyncio.sleep(5)
            plant.silent.clear()
            plant.delays[9] = 0.15
            polls = len(plant.times(9))
            while plant.fleet.devices["device 9"].state is not DeviceState.UP:
                await asyncio.sleep(0.1)
            assert len(plant.times(9)) <= polls + 1

    @in_simulated_time
    async def test_a_silent_device_is_polled_on_a_line_that_is_always_busy(self) -> None:
        plant = Plant()
        async with plant.polls(plant.device(9), plant.device(1, interval=0.05)):
            plant.silent.add(9)
            plant.delay = 0.06
            await asyncio.sleep(60)
            assert plant.fleet.statistics.skipped > 100
            assert len(plant.times(9)) >= 4
            plant.silent.clear()
            plant.delays[9] = 0.03
            await asyncio.sleep(70)
            assert plant.fleet.devices["device 9"].state is DeviceState.UP

    @in_simulated_time
    async def test_only_one_silent_device_of_a_line_is_polled_at_a_time(self) -> None:
        """Also where several requests may be on their way."""
        plant = Plant("tcp://10.0.0.1", "?timeout=5&max_in_flight=4")
        async with plant.polls(*(plant.device(unit) for unit in (1, 2, 3))):
            plant.silent.update((1, 2, 3))
            await asyncio.sleep(60)
            tries = [at for at, *_ in plant.asked[3:]]
            assert len(tries) >= 5
            assert min(gaps(tries)) >= 5.0

    @in_simulated_time
    async def test_the_second_request_of_a_trial_waits_for_others_too(self) -> None:
        plant = Plant()
        async with plant.polls(plant.device(9, MAP), plant.device(1, interval=0.1)):
            await asyncio.sleep(2)  # the response times are measured
            plant.silent.add(9)
            await asyncio.sleep(10)
            start = plant.now
            plant.silent.clear()
            plant.mute.add(9)
            while plant.fleet.devices["device 9"].state is not DeviceState.UP:
                await asyncio.sleep(0.05)
            assert plant.asked[-1][1] == 1
            assert max(gaps([at for at in plant.times(1) if at >= start])) < 0.25


class TestChanges:
    @in_simulated_time
    async def test_devices_may_change_before_they_are_polled(self) -> None:
        plant = Plant()
        fleet = Fleet([plant.device(1), plant.device(2)])
        fleet.replace([plant.device(2)])
        fleet.add([plant.device(3)])
        async with fleet:
            await asyncio.sleep(5)
        assert set(plant.units()) == {2, 3}

    @in_simulated_time
    async def test_a_device_whose_poll_waits_or_is_in_flight_can_be_removed(self) -> None:
        plant = Plant()
        devices = [plant.device(unit, interval=0.1) for unit in (1, 2, 3)]
        async with plant.polls(*devices):
            plant.delay = 0.2
            for _ in range(30):
                await asyncio.sleep(0.23)
                plant.fleet.replace(devices[1:])
                plant.fleet.replace(devices)
            line = next(iter(plant.fleet._lines.values()))
            plant.fleet.replace(devices[2:])
            since = plant.now + 0.6
            await asyncio.sleep(3)
            assert set(plant.units(since)) == {3}
            assert len(line.in_flight) <= 1
            assert list(line.pollers) == ["device 3"]

    @in_simulated_time
    async def test_a_silent_device_stays_paused_over_a_new_connection(self) -> None:
        plant = Plant("tcp://10.0.0.1", "?timeout=0.5")
        async with plant.polls(plant.device(9), plant.device(1)):
            plant.silent.add(9)
            await asyncio.sleep(20)
            while plant.units()[-1] != 9:
                await asyncio.sleep(0.01)
            await asyncio.sleep(1)
            plant.peer.drop_all()
            since = plant.now
            await asyncio.sleep(10)
            assert len(plant.units(since)) >= 8
            assert 9 not in plant.units(since)

    @in_simulated_time
    async def test_devices_of_a_restored_connection_are_polled_at_once(self) -> None:
        plant = Plant("tcp://10.0.0.1", "?timeout=0.5&max_pause=0.5")
        async with plant.polls(*(plant.device(unit) for unit in (1, 2, 3))):
            plant.network.unlisten(plant.url)
            plant.peer.drop_all()
            await asyncio.sleep(100)
            assert plant.asked == []
            assert plant.fleet.statistics.down == 3
            plant.network.listen(plant.peer.url, plant.peer._accept)
            # A device paused for a minute is asked when another one restores the connection.
            start = plant.now
            while plant.fleet.statistics.up < 3:
                await asyncio.sleep(0.1)
                assert plant.now < start + 70
            first = plant.asked[0][0]
            assert plant.now - first < 2.5

    @in_simulated_time
    async def test_over_tcp_max_in_flight_limits_the_polls(self) -> None:
        plant = Plant("tcp://10.0.0.1", "?timeout=5&max_in_flight=3")
        async with plant.polls(*(plant.device(unit, interval=0.5) for unit in range(1, 9))):
            plant.delay = 1.0
            await asyncio.sleep(30)
            most = max(
                sum(at <= other < at + 0.99 for other, *_ in plant.asked) for at, *_ in plant.asked
            )
            assert most == 3


@in_simulated_time
async def test_a_fleet_without_permission_to_ask_ends_its_single_round_at_once() -> None:
    plant = Plant()
    fleet = Fleet([plant.device(1), plant.device(2)], may_ask=lambda key: False)
    await asyncio.wait_for(fleet.run(once=True), 10)
    assert (fleet.statistics.vetoes, fleet.statistics.polls) == (2, 0)
    assert plant.asked == []


@in_simulated_time
async def test_a_late_answer_before_a_change_of_options_is_no_answer_after_it() -> None:
    """A fleet file was read again while a request was out, and a point was added to the map."""
    plant = Plant()
    far = RegisterMap([Point("far", "holding_registers", 9)])
    async with plant.polls(plant.device(1, interval=0.01)):
        for options in ("?timeout=0.4", "?timeout=0.5") * 10:
            await asyncio.sleep(1.01)
            plant.url, plant.delay = f"rtu:///dev/line{options}", 0.05
            plant.fleet.replace([plant.device(1, far, interval=0.01)])
            await asyncio.sleep(2)
            plant.delay = 0.3
            plant.fleet.replace([plant.device(1, interval=0.01)])
    values = {(item.name, item.value) for item in plant.readings if item.value is not None}
    assert values == {("near", 0), ("far", 9)}
