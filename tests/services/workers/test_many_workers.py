"""
No connection is asked by two, whatever happens: workers in simulated time. And when nothing
happens any more, each is asked by one.
"""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from libmodbus_py.services.engine.buckets import Change
from libmodbus_py.services.workers.records import FleetSettings
from tests.services.workers.simulated import LEASE, Process, World, encode_holder

ZONES = ("", "north")

NONSENSE = {"deleted": None, "empty": b"", "object": b"{}", "deep": b"[" * 9999}

which = st.integers(0, 5)
number = st.integers(1, 20)
zone = st.sampled_from(ZONES)


class Fleet(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.world = World(1)
        for at in range(10):
            self.world.configure(at)
        for _ in range(3):
            self.world.start(*ZONES)
        self.world.run(2 * LEASE)

    def process(self, at: int):
        processes = self.world.processes
        return processes[at % len(processes)] if processes else self.world.start(*ZONES)

    @rule(seconds=st.floats(0.1, 3 * LEASE))
    def run(self, seconds):
        self.world.run(seconds)

    @rule(zones=st.sampled_from([("",), ("north",), ZONES]))
    def start(self, zones):
        if len(self.world.processes) < 6:
            self.world.start(*zones)

    @rule(at=which)
    def kill(self, at):
        self.world.kill(self.process(at))

    @rule(at=which)
    def leave(self, at):
        self.process(at).worker.leave()

    @rule(at=which, is_stopped=st.booleans())
    def stop(self, at, is_stopped):
        self.process(at).is_stopped = is_stopped

    @rule(at=which, is_cut=st.booleans())
    def cut(self, at, is_cut):
        self.process(at).is_cut = is_cut

    @rule(at=which, delay=st.sampled_from([0.01, 0.5, 5.0, 30.0]))
    def delay(self, at, delay):
        self.process(at).delay = delay

    @rule(at=number, to=zone)
    def configure(self, at, to):
        self.world.configure(at, to)

    @rule(at=number)
    def unconfigure(self, at):
        self.world.unconfigure(at)

    @rule(data=st.data(), nonsense=st.sampled_from(sorted(NONSENSE)))
    def spoil(self, data, nonsense):
        """Whoever has the credentials writes what cannot be."""
        keys = [key for key in self.world.bucket.latest if not key.startswith("connection")]
        self.world.bucket.write(data.draw(st.sampled_from(sorted(keys))), NONSENSE[nonsense])
        self.mend()

    @rule(data=st.data())
    def purge(self, data):
        keys = [key for key in self.world.bucket.latest if not key.startswith("connection")]
        self.world.bucket.purge(data.draw(st.sampled_from(sorted(keys))))
        self.mend()

    def mend(self):
        self.world.bucket.write("settings", FleetSettings(LEASE).encode())

    @invariant()
    def none_is_asked_by_two(self):
        assert self.world.doubles == []

    @invariant()
    def nothing_is_decided_before_it_is_due(self):
        assert self.world.overslept == []

    def teardown(self):
        world = self.world
        for process in world.processes:
            process.is_stopped = process.is_cut = False
            process.delay = 0.01
            # As each does from time to time: nobody is told what was purged.
            process.again_at = world.now
        world.processes = [each for each in world.processes if not each.worker.left]
        for one in ZONES:
            world.start(one)
        world.run(6 * LEASE)
        assert world.doubles == []
        assert world.unasked == []


Fleet.TestCase.settings = settings(
    max_examples=8,
    stateful_step_count=25,
    # A failing schedule is told by its steps; shorter ones take minutes to find.
    phases=[Phase.explicit, Phase.reuse, Phase.generate],
    suppress_health_check=list(HealthCheck),
)
TestFleet = Fleet.TestCase


def of(world: World) -> Counter[int]:
    return Counter(id(each) for each in world.processes for key in each.worker.active if key)


def settled(*zones: str, processes: int, connections: int) -> World:
    world = World(7)
    for at in range(connections):
        world.configure(at, *zones)
    for _ in range(processes):
        world.start(*zones)
    world.run(2 * LEASE)
    return world


@pytest.mark.parametrize(("processes", "connections"), [(1, 5), (3, 100), (20, 5)])
def test_connections_are_shared_about_equally(processes, connections):
    world = settled(processes=processes, connections=connections)
    counts = of(world)
    assert sum(counts.values()) == connections
    assert len(counts) == min(processes, connections)
    slots = Counter(world.processes[0].worker.view.holders.values())
    assert max(slots.values()) - min(slots.values()) <= 1


# --- one fault each --------------------------------------------------------------------------


def two_zones() -> World:
    """One worker for each zone; all connections are in the first."""
    world = World(5)
    for at in range(10):
        world.configure(at)
    world.start("")
    world.start("north")
    world.run(2 * LEASE)
    return world


def cut_off(world: World) -> None:
    world.processes[0].is_cut = True


def stopped(world: World) -> None:
    world.processes[0].is_stopped = True


def forgotten(world: World) -> None:
    """Somebody deletes the worker that hears nothing, and its slots."""
    worker = world.processes[0].worker
    cut_off(world)
    world.bucket.write(worker.key, None)
    for slot in worker.view.used_slots:
        world.bucket.write(slot.key, None)


def moved_before_it_was_forgotten(world: World) -> None:
    cut_off(world)
    world.bucket.write(world.processes[0].worker.key, None)
    moved(world)


def moved(world: World) -> None:
    for at in range(10):
        world.configure(at, "north")


def moved_while_one_is_late(world: World) -> None:
    world.processes[0].delay = 6.0
    moved(world)


def slots_were_written_by_a_stranger(world: World) -> None:
    late, other = world.processes
    late.delay = 6.0
    for slot in late.worker.view.used_slots:
        world.bucket.write(slot.key, encode_holder(other.worker.id, "stranger.1"))


def bucket_went_back(world: World) -> None:
    """The engine forgets what it had confirmed: that a newcomer has slots, and hears nothing."""
    before = dict(world.bucket.latest), world.bucket.revision
    newcomer = world.start(*ZONES)
    world.run(LEASE)
    _go_back(world, newcomer, before)


def bucket_went_back_beyond_two_newcomers(world: World) -> None:
    """The second change of a slot that is remembered says nothing about the first."""
    before = dict(world.bucket.latest), world.bucket.revision
    first = world.start(*ZONES)
    world.run(LEASE)
    first.worker.leave()
    world.run(LEASE)
    world.kill(first)
    second = world.start(*ZONES)
    world.run(LEASE)
    _go_back(world, second, before)


def _go_back(world: World, newcomer: Process, before: tuple[dict[str, Change], int]) -> None:
    newcomer.is_cut = True
    world.bucket.latest, world.bucket.revision = before
    for process in world.processes:
        process.again_at = world.now


def bucket_was_emptied(world: World) -> None:
    """Nobody who is left, or comes, knows who polls."""
    cut_off(world)
    for process in world.processes[1:]:
        world.kill(process)
    world.bucket.purge()
    world.bucket.write("settings", FleetSettings(LEASE).encode())
    for connection in world.connections.values():
        world.bucket.write(connection.bucket_key, connection.encode())
    world.start(*ZONES)


FAULTS = [
    bucket_was_emptied,
    cut_off,
    stopped,
    forgotten,
    moved,
    moved_while_one_is_late,
    moved_before_it_was_forgotten,
    slots_were_written_by_a_stranger,
    bucket_went_back,
    bucket_went_back_beyond_two_newcomers,
]


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("make", [two_zones, lambda: settled(processes=2, connections=10)])
def test_none_is_asked_by_two(fault, make):
    world = make()
    assert world.unasked == []
    fault(world)
    world.run(LEASE * 0.7)
    world.processes[0].is_stopped = False
    world.run(LEASE)
    world.start(*ZONES)
    for process in world.processes:
        process.is_cut = False
        process.delay = 0.01
    world.run(3 * LEASE)
    assert world.doubles == []
    assert world.unasked == []


def test_a_lease_is_counted_from_before_it_was_sent():
    """One whose way is slow sees late what it sent, and loses the bucket then."""
    world = settled(processes=2, connections=10)
    slow = world.processes[0]
    slow.delay = 8.0
    world.run(5 * LEASE)
    slow.is_cut = True
    world.run(2 * LEASE)
    assert world.doubles == []
