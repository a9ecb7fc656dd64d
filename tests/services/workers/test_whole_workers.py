"""
Whole workers, with their fleets, on simulated time: none of the devices is asked by two, and gaps
are as promised, whoever dies, stops, leaves or hears nothing. A device that a worker does not poll
any more is reported "offline" if no other one polls it, and not late.
"""

import asyncio
import json

import pytest

from libmodbus_py.services.workers.records import FleetSettings
from tests.services.workers.trial import INTERVAL, LEASE, UNITS, Trial, on_trial
from tests.simulation import network
from tests.simulation.workers import push_fleet

# A dead worker's lease is over for others after 1.05 of it; writing, and asking, come then.
TAKEN_OVER = 1.05 * LEASE + 0.1 + INTERVAL

# A worker uses nine tenths of its lease.
OWN_LEASE = 0.9 * LEASE


@on_trial(6, "a", "b", "c")
async def test_a_killed_worker_is_replaced_when_its_lease_is_over(trial: Trial) -> None:
    trial.kill("b")
    assert OWN_LEASE - INTERVAL < await trial.all_asked(60) < TAKEN_OVER
    await asyncio.sleep(5)
    assert trial.asked.gap < TAKEN_OVER + INTERVAL
    await trial.start("b")
    await trial.settle()
    assert len(trial.asked.hosts()) == 3


@on_trial(6, "a", "b")
async def test_a_joining_worker_gets_its_share_soon_and_without_a_gap(trial: Trial) -> None:
    await trial.start("c")
    assert await trial.until(lambda: len(trial.asked.hosts()) == 3, 60) < 2.0
    await asyncio.sleep(2)
    assert min(trial.asked.hosts().values()) >= UNITS
    assert trial.asked.gap < 2 * INTERVAL


@on_trial(6, "a", "b", "c")
async def test_a_leaving_worker_is_replaced_at_once(trial: Trial) -> None:
    await trial.workers.pop("b").leave()
    assert await trial.all_asked(60) < 2 * INTERVAL
    await asyncio.sleep(2 * LEASE)
    # Nobody waited for a lease.
    assert trial.asked.gap < 2 * INTERVAL
    assert len(trial.asked.hosts()) == 2
    assert trial.offline() == []


@pytest.mark.parametrize("seconds", [0.3, LEASE, 3 * LEASE])
@on_trial(6, "a", "b", "c")
async def test_a_worker_that_was_stopped_polls_no_device_of_others(trial: Trial, seconds) -> None:
    process = trial.workers["b"].process
    process.stop()
    await asyncio.sleep(seconds)
    process.go_on()
    await trial.settle()
    assert len(trial.asked.hosts()) == 3
    assert trial.offline() == []
    assert trial.qualities() == ["good"]


@pytest.mark.parametrize("seconds", [0.3, LEASE, 3 * LEASE])
@on_trial(6, "a", "b", "c")
async def test_a_worker_without_the_engine_polls_no_longer_than_its_lease(trial: Trial, seconds):
    cut = trial.workers["a"]
    host = cut.process.host
    since = trial.now
    cut.client.link.cut()
    await asyncio.sleep(seconds)
    if seconds > 2 * LEASE:
        assert {worker for _, worker, _ in trial.offline()} == {"a"}
        assert max(trial.offline())[0] < since + LEASE
        its = [at for at, peer in trial.asked.last.values() if peer.startswith(host)]
        assert max(its, default=0) < since + OWN_LEASE
        assert await trial.all_asked(60) < 2 * INTERVAL
    cut.client.link.mend()
    await trial.settle()
    assert len(trial.asked.hosts()) == 3
    assert trial.qualities() == ["good"]


@pytest.mark.parametrize("seconds", [0.3, 5 * LEASE])
@on_trial(6, "a", "b", "c")
async def test_without_the_engine_no_worker_polls_beyond_its_lease(trial: Trial, seconds) -> None:
    trial.engine.stop()
    since = trial.now
    await asyncio.sleep(seconds)
    if seconds > LEASE:
        assert since + 0.5 * LEASE < trial.asked.latest < since + OWN_LEASE
        assert trial.qualities() == ["offline"]
        assert max(trial.offline())[0] < since + LEASE
    trial.engine.start()
    # A lost connection is tried again each quarter of a second, and so is watching.
    assert await trial.all_asked(60) < TAKEN_OVER + LEASE
    await trial.settle()
    assert len(trial.asked.hosts()) == 3
    assert trial.qualities() == ["good"]


@on_trial(2, "a", settings=FleetSettings(LEASE, "continue"))
async def test_a_worker_continues_without_the_engine_if_its_settings_say_so(trial: Trial) -> None:
    trial.engine.stop()
    start = trial.now
    await asyncio.sleep(10)
    assert trial.asked.gap < INTERVAL + 0.1
    back = trial.now
    trial.engine.start()
    await asyncio.sleep(20)  # an output is tried again after pauses, each twice as long
    times = [
        json.loads(data)["values"]["level"]["time"]
        for _, subject, data in trial.engine.stream
        if subject == "modbus.readings.d0-1"
    ]
    assert times == sorted(set(times))
    assert len(times) >= (back - start) / INTERVAL


@on_trial(6, "a", "b", "c")
async def test_a_slow_engine_loses_leases_but_no_device(trial: Trial) -> None:
    for worker in trial.workers.values():
        worker.client.link.delay = (0.3, 0.6)
    await asyncio.sleep(10)
    for worker in trial.workers.values():
        worker.client.link.delay = None
    await trial.settle()


@pytest.mark.parametrize("seconds", [0.5, LEASE, 3 * LEASE])
@on_trial(6, "a", "b", "c")
async def test_one_worker_polls_after_a_restored_engine(trial: Trial, seconds: float) -> None:
    await trial.start("d")
    await asyncio.sleep(seconds / 2)
    trial.engine.forget(seconds)
    await trial.settle()
    assert len(trial.asked.hosts()) >= 3


@on_trial(4, "a", "b")
async def test_the_time_of_day_may_be_set_to_any_value(trial: Trial, monkeypatch) -> None:
    """Leases do not end or grow, and no reading is taken for one that was sent before."""
    for hours in (-1, 2):
        monkeypatch.setattr(network, "EPOCH", network.EPOCH + 3600 * hours)
        trial.engine.stream.clear()
        await asyncio.sleep(2 * LEASE)
        assert trial.asked.gap < 1.5 * INTERVAL
        assert len(trial.engine.stream) >= trial.count * (2 * LEASE / INTERVAL - 1)
    trial.kill("a")
    assert await trial.all_asked(60) < LEASE + INTERVAL + 1.5


@on_trial(6, "a", "b", "c")
async def test_a_deleted_bucket_stops_all_workers_until_it_is_pushed_again(trial: Trial, caplog):
    trial.engine.delete_bucket()
    since = trial.now
    await asyncio.sleep(2 * LEASE)
    assert trial.asked.latest < since + OWN_LEASE
    assert "was deleted" in caplog.text
    trial.engine.create_bucket()
    await push_fleet(trial.engine, trial.devices(), trial.settings)
    await trial.settle()
    assert len(trial.asked.hosts()) == 3


@on_trial(6)
async def test_a_change_reaches_the_workers_within_a_second_and_affects_nothing_else(trial: Trial):

    await push_fleet(trial.engine, trial.devices(4), trial.settings)
    await trial.start("a", "b")
    await asyncio.sleep(3 * LEASE)
    before = {device: peer for device, (_, peer) in trial.asked.last.items()}
    assert len(before) == 4 * UNITS
    pushed = await push_fleet(trial.engine, trial.devices(), trial.settings)
    assert pushed == (2, 0, 0)
    assert await trial.all_asked(60) < 1 + INTERVAL
    after = {device: peer for device, (_, peer) in trial.asked.last.items()}
    assert before.items() <= after.items()
    assert await push_fleet(trial.engine, trial.devices(1), trial.settings) == (0, 0, 5)
    await asyncio.sleep(0.5)
    now = trial.now
    await asyncio.sleep(2)
    assert trial.asked.since(now) == UNITS


@on_trial(2, "a", "b")
async def test_a_device_removed_from_the_bucket_is_offline(trial: Trial) -> None:
    await push_fleet(trial.engine, trial.devices(1), trial.settings)
    await trial.until(trial.offline, LEASE)
    assert len(trial.offline()) == 2 * UNITS
    assert {device for *_, device in trial.offline()} == {"d1-1", "d1-2"}
    # Into a zone without workers.
    await push_fleet(trial.engine, trial.devices(zone="north"))
    await trial.until(lambda: trial.qualities() == ["offline"], LEASE)


@on_trial(2, "a")
async def test_the_last_worker_to_leave_reports_all_devices_offline(trial: Trial) -> None:
    await trial.workers.pop("a").leave()
    assert trial.qualities() == ["offline"]


@on_trial(2)
async def test_devices_of_a_dead_worker_in_a_zone_without_workers_are_offline(trial: Trial) -> None:
    await push_fleet(trial.engine, trial.devices(zone="north"), trial.settings)
    await trial.start("north", zones=["north"])
    await trial.start("a", "b")
    await asyncio.sleep(3 * LEASE)
    assert trial.qualities() == ["good"]
    trial.kill("north")
    assert await trial.until(lambda: trial.qualities() == ["offline"], 60) < 3 * LEASE
    await asyncio.sleep(5 * LEASE)
    # Reported once, by one of those that are left.
    assert len(trial.offline()) == 2 * trial.count
    assert len({worker for _, worker, _ in trial.offline()}) == 1
    assert trial.asked.latest < trial.now - 5 * LEASE  # the others wait for a worker of the zone
    await trial.start("north", zones=["north"])
    await asyncio.sleep(3 * LEASE)
    assert trial.qualities() == ["good"]
    trial.kill("north")
    await trial.until(lambda: trial.qualities() == ["offline"], 60)
