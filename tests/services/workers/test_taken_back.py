"""
What workers report of devices that they do not poll any more: nothing if another one polls them,
"offline" if none can; and nothing late, when another one polls them already.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

from libmodbus_py.fleet import Reading
from tests.services.workers.trial import INTERVAL, LEASE, UNITS, Trial, tried
from tests.simulation.workers import push_fleet


class Told:
    """An output as those of a broker: what each device was reported to be, by whom and when."""

    name = "told"

    def __init__(self, trial: Trial, worker: str, all_told: list[tuple[float, str, Reading]]):
        self._trial = trial
        self._worker = worker
        self._all_told = all_told

    async def open(self) -> None: ...

    async def write(self, readings: Sequence[Reading]) -> None:
        self._all_told += [(self._trial.now, self._worker, each) for each in readings]

    async def close(self) -> None: ...


class Fleet:
    """Workers that share a trial, and what is known of each point: its last reading."""

    def __init__(self, trial: Trial) -> None:
        self.trial = trial
        self.told: list[tuple[float, str, Reading]] = []

    async def start(self, *names: str, **options: Any) -> None:
        for name in names:
            await self.trial.start(name, outputs=[Told(self.trial, name, self.told)], **options)
        await self.trial.settle()

    def qualities(self) -> list[str]:
        last = {(each.device, each.name): each.quality for _, _, each in self.told}
        assert len(last) == 2 * self.trial.count
        return sorted(set(last.values()))

    def offline(self) -> list[tuple[float, str]]:
        return [(at, worker) for at, worker, each in self.told if each.quality == "offline"]


@tried(6)
async def test_a_device_that_passes_to_another_worker_is_never_offline(trial: Trial) -> None:
    fleet = Fleet(trial)
    await fleet.start("a")
    await fleet.start("b")
    await trial.workers.pop("a").leave()
    await trial.settle()
    assert fleet.offline() == []
    assert fleet.qualities() == ["good"]


@tried(2)
async def test_a_device_that_is_pushed_away_is_offline(trial: Trial) -> None:
    fleet = Fleet(trial)
    await fleet.start("a", "b")
    await push_fleet(trial.engine, trial.devices(1), trial.settings)
    await trial.until(lambda: fleet.offline(), LEASE)
    assert len(fleet.offline()) == 2 * UNITS
    assert {each.device for *_, each in fleet.told if each.quality == "offline"} == {
        "d1-1",
        "d1-2",
    }
    # Into a zone without workers.
    await push_fleet(trial.engine, trial.devices(zone="north"))
    await trial.until(lambda: fleet.qualities() == ["offline"], LEASE)


@tried(2)
async def test_the_last_worker_that_leaves_takes_all_back(trial: Trial) -> None:
    fleet = Fleet(trial)
    await fleet.start("a")
    await trial.workers.pop("a").leave()
    assert fleet.qualities() == ["offline"]


@tried(4)
async def test_without_the_engine_all_is_offline_when_leases_end_and_good_again_afterwards(
    trial: Trial,
) -> None:
    fleet = Fleet(trial)
    await fleet.start("a", "b")
    since = trial.now
    trial.engine.stop()
    await trial.until(lambda: fleet.qualities() == ["offline"], LEASE)
    assert 0.5 * LEASE < trial.now - since < LEASE
    trial.engine.start()
    await trial.settle()
    assert fleet.qualities() == ["good"]


@tried(6)
async def test_who_is_cut_off_takes_its_devices_back_before_another_one_polls_them(
    trial: Trial,
) -> None:
    fleet = Fleet(trial)
    await fleet.start("a", "b")
    cut = trial.workers["a"].client
    trial.engine.cut(cut)
    await trial.until(fleet.offline, LEASE)
    assert {worker for _, worker in fleet.offline()} == {"a"}
    await trial.all_asked(LEASE + INTERVAL)
    trial.engine.mend(cut)
    await trial.settle()
    assert fleet.qualities() == ["good"]


@tried(6)
async def test_who_was_stopped_says_nothing_of_devices_that_another_one_polls(trial: Trial) -> None:
    fleet = Fleet(trial)
    await fleet.start("a", "b")
    process = trial.workers["a"].process
    process.stop()
    await trial.all_asked(2 * LEASE)
    process.go_on()
    await trial.settle()
    assert fleet.offline() == []
    assert fleet.qualities() == ["good"]


@tried(2)
async def test_devices_of_a_dead_worker_whose_zone_nobody_has_are_offline(trial: Trial) -> None:
    fleet = Fleet(trial)
    await push_fleet(trial.engine, trial.devices(zone="north"), trial.settings)
    await fleet.start("north", zones=["north"])
    for name in ("a", "b"):
        await trial.start(name, outputs=[Told(trial, name, fleet.told)])
    await asyncio.sleep(3 * LEASE)
    assert fleet.qualities() == ["good"]
    trial.kill("north")
    assert await trial.until(lambda: fleet.qualities() == ["offline"], 60) < 3 * LEASE
    await asyncio.sleep(5 * LEASE)
    # Reported once, by one of those that are left.
    assert len(fleet.offline()) == 2 * trial.count
    assert len({worker for _, worker in fleet.offline()}) == 1
    await trial.start("north", zones=["north"], outputs=[Told(trial, "north", fleet.told)])
    await asyncio.sleep(3 * LEASE)
    assert fleet.qualities() == ["good"]
    trial.kill("north")
    await trial.until(lambda: fleet.qualities() == ["offline"], 60)
