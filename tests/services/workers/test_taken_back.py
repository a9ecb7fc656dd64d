"""
What workers report of devices that they do not poll any more: nothing if another one polls them,
"offline" if none can; and nothing late, when another one polls them already.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

from libmodbus_py.fleet import Reading
from tests.services.workers.trial import INTERVAL, LEASE, UNITS, Trial
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

    def __init__(self, connections: int) -> None:
        self.trial = Trial(connections)
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


def test_a_device_that_passes_to_another_worker_is_never_offline() -> None:
    fleet = Fleet(6)

    async def main() -> None:
        await fleet.start("a")
        await fleet.start("b")
        await fleet.trial.workers.pop("a").leave()
        await fleet.trial.settle()
        assert fleet.offline() == []
        assert fleet.qualities() == ["good"]

    fleet.trial.run(main)


def test_a_device_that_is_pushed_away_is_offline() -> None:
    fleet = Fleet(2)

    async def main() -> None:
        await fleet.start("a", "b")
        await push_fleet(fleet.trial.engine, fleet.trial.devices(1), fleet.trial.settings)
        await fleet.trial.until(lambda: fleet.offline(), LEASE)
        assert len(fleet.offline()) == 2 * UNITS
        assert {each.device for *_, each in fleet.told if each.quality == "offline"} == {
            "d1-1",
            "d1-2",
        }
        # Into a zone without workers.
        await push_fleet(fleet.trial.engine, fleet.trial.devices(zone="north"))
        await fleet.trial.until(lambda: fleet.qualities() == ["offline"], LEASE)

    fleet.trial.run(main)


def test_the_last_worker_that_leaves_takes_all_back() -> None:
    fleet = Fleet(2)

    async def main() -> None:
        await fleet.start("a")
        await fleet.trial.workers.pop("a").leave()
        assert fleet.qualities() == ["offline"]

    fleet.trial.run(main)


def test_without_the_engine_all_is_offline_when_leases_end_and_good_again_afterwards() -> None:
    fleet = Fleet(4)

    async def main() -> None:
        await fleet.start("a", "b")
        since = fleet.trial.now
        fleet.trial.engine.stop()
        await fleet.trial.until(lambda: fleet.qualities() == ["offline"], LEASE)
        assert 0.5 * LEASE < fleet.trial.now - since < LEASE
        fleet.trial.engine.start()
        await fleet.trial.settle()
        assert fleet.qualities() == ["good"]

    fleet.trial.run(main)


def test_who_is_cut_off_takes_its_devices_back_before_another_one_polls_them() -> None:
    fleet = Fleet(6)

    async def main() -> None:
        await fleet.start("a", "b")
        cut = fleet.trial.workers["a"].client
        fleet.trial.engine.cut(cut)
        await fleet.trial.until(fleet.offline, LEASE)
        assert {worker for _, worker in fleet.offline()} == {"a"}
        await fleet.trial.all_asked(LEASE + INTERVAL)
        fleet.trial.engine.mend(cut)
        await fleet.trial.settle()
        assert fleet.qualities() == ["good"]

    fleet.trial.run(main)


def test_who_was_stopped_says_nothing_of_devices_that_another_one_polls() -> None:
    fleet = Fleet(6)

    async def main() -> None:
        await fleet.start("a", "b")
        process = fleet.trial.workers["a"].process
        process.stop()
        await fleet.trial.all_asked(2 * LEASE)
        process.go_on()
        await fleet.trial.settle()
        assert fleet.offline() == []
        assert fleet.qualities() == ["good"]

    fleet.trial.run(main)


def test_devices_of_a_dead_worker_whose_zone_nobody_has_are_offline() -> None:
    fleet = Fleet(2)
    trial = fleet.trial

    async def main() -> None:
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

    trial.run(main)


def test_devices_of_a_dead_worker_that_others_take_over_are_never_offline() -> None:
    fleet = Fleet(6)

    async def main() -> None:
        await fleet.start("a", "b", "c")
        fleet.trial.kill("b")
        await asyncio.sleep(6 * LEASE)
        assert fleet.offline() == []

    fleet.trial.run(main)
