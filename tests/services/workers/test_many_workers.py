"""
No connection is asked by two, whatever happens: workers in simulated time. And when nothing
happens any more, each is asked by one.
"""

from collections import Counter
from collections.abc import Callable

import pytest

from libmodbus_py.services.engine.buckets import Change
from libmodbus_py.services.workers.records import FleetSettings
from tests.services.workers.simulated import LEASE, Process, World, encode_holder

ZONES = ("", "north")

NONSENSE = (None, b"", b"{}", b"[" * 9999)


def one_of(world: World) -> Process:
    return world.random.choice(world.processes) if world.processes else world.start(*ZONES)


def start(world: World) -> None:
    if len(world.processes) < 6:
        world.start(*world.random.choice([("",), ("north",), ZONES]))


def stop_or_go_on(world: World) -> None:
    one_of(world).is_stopped = world.random.random() < 0.5


def cut_or_mend(world: World) -> None:
    one_of(world).is_cut = world.random.random() < 0.5


def delay(world: World) -> None:
    one_of(world).delay = world.random.choice([0.01, 0.5, 5.0, 30.0])


def own_key(world: World) -> str:
    keys = [key for key in world.bucket.latest if not key.startswith("connection")]
    return world.random.choice(sorted(keys))


def spoil(world: World) -> None:
    """Whoever has the credentials writes what cannot be."""
    world.bucket.write(own_key(world), world.random.choice(NONSENSE))
    world.bucket.write("settings", FleetSettings(LEASE).encode())


def purge(world: World) -> None:
    world.bucket.purge(own_key(world))
    world.bucket.write("settings", FleetSettings(LEASE).encode())


EVENTS: list[Callable[[World], object]] = [
    *(start, stop_or_go_on, cut_or_mend, delay, spoil, purge),
    lambda world: world.kill(one_of(world)),
    lambda world: one_of(world).worker.leave(),
    lambda world: world.configure(world.random.randint(1, 20), world.random.choice(ZONES)),
    lambda world: world.unconfigure(world.random.randint(1, 20)),
]


@pytest.mark.parametrize("seed", range(8))
def test_no_device_is_polled_by_two_workers_and_each_by_one_in_the_end(seed: int) -> None:
    world = World(seed)
    for at in range(10):
        world.configure(at)
    for _ in range(3):
        world.start(*ZONES)
    world.run(2 * LEASE)
    for _ in range(25):
        world.random.choice(EVENTS)(world)
        world.run(world.random.uniform(0.1, 3 * LEASE))
        assert world.doubles == world.overslept == []
    for process in world.processes:
        process.is_stopped = process.is_cut = False
        process.delay = 0.01
        # As each does from time to time: nobody is told what was purged.
        process.again_at = world.now
    world.processes = [process for process in world.processes if not process.worker.has_left]
    for zone in ZONES:
        world.start(zone)
    world.run(6 * LEASE)
    assert world.doubles == world.unasked == []


def of(world: World) -> Counter[int]:
    return Counter(id(item) for item in world.processes for key in item.worker.active if key)


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
def test_no_device_is_polled_by_two_workers(fault, make):
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


def test_a_slow_network_loses_no_lease(monkeypatch):
    """A write and its change take 0.3 of a lease, and both workers wait as long."""
    world = settled(processes=2, connections=10)
    monkeypatch.setattr(world.random, "random", lambda: 1.0)
    ids = [process.worker.id for process in world.processes]
    for process in world.processes:
        process.delay = 0.15 * LEASE
    world.run(LEASE)
    for _ in range(100):
        world.run(0.1 * LEASE)
        assert all(process.worker.may_poll(process.now) for process in world.processes)
    assert ids == [process.worker.id for process in world.processes]
    assert (world.doubles, world.unasked) == ([], [])
