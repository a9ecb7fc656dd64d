"""
What workers report of devices that they do not poll any more: nothing if another one polls them,
"offline" if none can; and nothing late, when another one polls them already.
"""

from __future__ import annotations

import asyncio

from tests.services.workers.trial import INTERVAL, LEASE, UNITS, Trial, tried
from tests.simulation.workers import push_fleet


@tried(6, "a")
async def test_a_device_that_passes_to_another_worker_is_never_offline(trial: Trial) -> None:
    await trial.start("b")
    await trial.settle()
    await trial.workers.pop("a").leave()
    await trial.settle()
    assert trial.offline() == []
    assert trial.qualities() == ["good"]


@tried(2, "a", "b")
async def test_a_device_that_is_pushed_away_is_offline(trial: Trial) -> None:
    await push_fleet(trial.engine, trial.devices(1), trial.settings)
    await trial.until(trial.offline, LEASE)
    assert len(trial.offline()) == 2 * UNITS
    assert {device for _, device in trial.offline()} == {"d1-1", "d1-2"}
    # Into a zone without workers.
    await push_fleet(trial.engine, trial.devices(zone="north"))
    await trial.until(lambda: trial.qualities() == ["offline"], LEASE)


@tried(2, "a")
async def test_the_last_worker_that_leaves_takes_all_back(trial: Trial) -> None:
    await trial.workers.pop("a").leave()
    assert trial.qualities() == ["offline"]


@tried(4, "a", "b")
async def test_without_the_engine_all_is_offline_when_leases_end_and_good_again_afterwards(
    trial: Trial,
) -> None:
    since = trial.now
    trial.engine.stop()
    await trial.until(lambda: trial.qualities() == ["offline"], LEASE)
    assert 0.5 * LEASE < trial.now - since < LEASE
    trial.engine.start()
    await trial.settle()
    assert trial.qualities() == ["good"]


@tried(6, "a", "b")
async def test_who_is_cut_off_takes_its_devices_back_before_another_one_polls_them(
    trial: Trial,
) -> None:
    cut = trial.workers["a"].client
    trial.engine.cut(cut)
    await trial.until(trial.offline, LEASE)
    assert {worker for worker, _ in trial.offline()} == {"a"}
    await trial.all_asked(LEASE + INTERVAL)
    trial.engine.mend(cut)
    await trial.settle()
    assert trial.qualities() == ["good"]


@tried(6, "a", "b")
async def test_who_was_stopped_says_nothing_of_devices_that_another_one_polls(trial: Trial) -> None:
    process = trial.workers["a"].process
    process.stop()
    await trial.all_asked(2 * LEASE)
    process.go_on()
    await trial.settle()
    assert trial.offline() == []
    assert trial.qualities() == ["good"]


@tried(2)
async def test_devices_of_a_dead_worker_whose_zone_nobody_has_are_offline(trial: Trial) -> None:
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
    assert len({worker for worker, _ in trial.offline()}) == 1
    await trial.start("north", zones=["north"])
    await asyncio.sleep(3 * LEASE)
    assert trial.qualities() == ["good"]
    trial.kill("north")
    await trial.until(lambda: trial.qualities() == ["offline"], 60)
