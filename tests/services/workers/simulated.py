"""
Decisions of workers in simulated time: of one that sees its bucket at once, and of many, whose
messages are late, whose writes are late or lost, whose clocks go wrong and which stop. Every asking
is recorded at its real time.
"""

from __future__ import annotations

import heapq
import itertools
import random
from dataclasses import dataclass, field
from typing import Any

from libmodbus_py.services.engine.buckets import Change
from libmodbus_py.services.workers.decisions import decide, step
from libmodbus_py.services.workers.records import (
    SETTINGS,
    Connection,
    FleetSettings,
    Holding,
    Member,
    Slot,
    decode,
)
from libmodbus_py.services.workers.worker import Decision, Put, Worker

LEASE = 10.0
TICK = 0.1
TIMEOUT = 0.5


def encode_holder(worker: str, by: str) -> bytes:
    """Return the value of a slot."""
    return Holding(Slot("", 0), worker, by).encode()


class OneWorker:
    """A worker that sees its bucket at once, while it hears. Others are what a test writes."""

    def __init__(
        self,
        *connections: Connection,
        settings: FleetSettings | None = None,
        name: str = "m",
        lives: bool = False,
    ) -> None:
        ids = (f"{name}.{number}" for number in itertools.count(1))
        self.worker = Worker(lambda: next(ids), {""})
        self.latest: dict[str, Change] = {}
        self.revision = 0
        self.hears = True
        self.last = Decision({})
        self.worker.begin_snapshot()
        self.write(SETTINGS, (settings or FleetSettings(LEASE)).encode())
        for connection in connections:
            self.write(connection.bucket_key, connection.encode())
        if lives:
            self.member(self.me, 0.0)
        self.worker.end_snapshot(0.0)

    @property
    def me(self) -> str:
        return self.worker.id

    def write(self, key: str, value: bytes | None, at: float = 0.0) -> None:
        self.revision += 1
        self.latest[key] = Change(key, value, self.revision)
        if self.hears:
            self.worker.add_change(self.latest[key], at)

    def member(
        self, id: str, at: float = 0.0, state: Any = "here", revision: int | None = None
    ) -> None:
        number = self.revision if revision is None else revision
        beat = self.revision
        self.write(f"worker.{id}", Member(id, state, ("",), LEASE, beat, number).encode(), at)

    def hold(self, connection: Connection, holder: str, at: float = 0.0, by: str = "") -> None:
        self.write(connection.slot.key, encode_holder(holder, by or holder), at)

    def read_again(self, at: float) -> None:
        """The worker reads all that the bucket contains."""
        self.worker.begin_snapshot()
        for entry in sorted(self.latest.values(), key=lambda each: each.revision):
            self.worker.add_change(entry, at)
        self.worker.end_snapshot(at)

    def decided(self, at: float) -> list[Put]:
        """Return the writes of a decision, none of which arrives."""
        before = decide(self.worker, at)
        self.last = step(self.worker, at)
        assert self.last == before, "the first one had an effect"
        return list(self.last.puts)

    def step(self, at: float) -> list[Put]:
        """Decide; all writes succeed. Return those that are not about its own lease."""
        is_early, active = at < self.worker.due, self.worker.active
        puts = self.decided(at)
        assert not is_early or (puts, self.worker.active) == ([], active), "it was due"
        for put in puts:
            record = self.latest.get(put.key)
            assert put.last == (record.revision if record else 0)
            self.write(put.key, put.value, at)
        return [put for put in puts if put.key != self.worker.key]

    def steps(self, *times: float) -> list[Put]:
        return [put for at in times for put in self.step(at)]

    def polled(self) -> set[str]:
        return set(self.worker.active)


def records(puts: list[Put]) -> dict[str, Any]:
    """Return what stands in writes: the state of a worker, the holder of a slot, or None."""
    states: dict[str, Any] = {}
    for put in puts:
        record = decode(put.key, put.value) if put.value is not None else None
        if isinstance(record, Member):
            states[put.key] = record.state
        else:
            states[put.key] = record.holder if isinstance(record, Holding) else None
    return states


def every(start: float, end: float, pause: float = 1.0) -> list[float]:
    return [start + pause * at for at in range(int((end - start) / pause) + 1)]


class Bucket:
    """One stream with one value for each key, written on conditions."""

    def __init__(self) -> None:
        self.revision = 0
        self.latest: dict[str, Change] = {}
        self.watchers: list[Process] = []

    def put(self, put: Put) -> None:
        record = self.latest.get(put.key)
        if (record.revision if record else 0) == put.last:
            self.write(put.key, put.value)

    def write(self, key: str, value: bytes | None) -> None:
        self.revision += 1
        self.latest[key] = entry = Change(key, value, self.revision)
        for watcher in self.watchers:
            watcher.send(entry)

    def purge(self, *keys: str) -> None:
        """Without telling anybody."""
        for key in keys or list(self.latest):
            self.latest.pop(key, None)


@dataclass
class Process:
    """A worker with a clock, and ways to the bucket and back."""

    world: World
    name: str
    zones: tuple[str, ...]
    rate: float
    offset: float
    delay: float = 0.01
    is_cut: bool = False
    is_stopped: bool = False
    inbox: list[tuple[float, int, Change | None]] = field(default_factory=list)
    counter: itertools.count[int] = field(default_factory=itertools.count)
    # When it watches again, if it has lost something.
    again_at: float | None = 0.0
    open: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.worker = Worker(self.new_id, self.zones)

    def new_id(self) -> str:
        return f"{self.name}.{next(self.world.nonces)}"

    @property
    def now(self) -> float:
        return self.offset + self.rate * self.world.now

    def send(self, entry: Change | None) -> None:
        """From the bucket: in order, at some time."""
        if self.is_cut or self.again_at is not None:
            # A gap: nothing comes after it before all is read again.
            self.again_at = self.again_at or self.world.now + 1
            return
        last = self.inbox[-1][0] if self.inbox else 0.0
        at = max(last, self.world.now + self.delay * self.world.random.random())
        self.inbox.append((at, next(self.counter), entry))

    def watch(self) -> None:
        self.again_at = None
        self.inbox.clear()
        self.worker.begin_snapshot()
        for entry in sorted(self.world.bucket.latest.values(), key=lambda each: each.revision):
            self.send(entry)
        self.send(None)

    def turn(self) -> None:
        """One turn of the worker's loop; waiting messages come before or after its clock."""
        if self.is_stopped:
            return
        if self.again_at is not None and not self.is_cut and self.world.now >= self.again_at:
            self.watch()
        ready = [row for row in self.inbox if row[0] <= self.world.now]
        if self.world.random.random() < 0.2:
            ready = ready[: self.world.random.randrange(len(ready) + 1)]
        for row in ready:
            self.inbox.remove(row)
            entry = row[2]
            if entry is None:
                self.worker.end_snapshot(self.now)
            else:
                self.worker.add_change(entry, self.now)
        is_due = self.worker.due <= self.now
        active = self.worker.active
        decision = step(self.worker, self.now)
        if not is_due and (decision.puts or decision.active != active):
            self.world.overslept.append(f"{self.now}: {decision}")
        self.world.cut_off(self, self.open - set(self.worker.active))
        self.open = set(self.worker.active)
        for put in decision.puts:
            self.write(put)
        if self.again_at is None and decision.must_read_again:
            self.again_at = self.world.now

    def write(self, put: Put) -> None:
        chance = self.world.random.random()
        if self.is_cut:
            # What a client keeps for when it is connected again.
            if chance < 0.02:
                self.world.later(chance * 500, put)
        else:
            self.world.later(self.delay * chance, put)


class World:
    """All workers and the bucket; a seed and calls of the methods decide the events."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.now = 1000.0
        self.nonces = itertools.count(1)
        self.bucket = Bucket()
        self.bucket.write("settings", FleetSettings(LEASE).encode())
        self.processes: list[Process] = []
        self.writes: list[tuple[float, int, Put]] = []
        self.order = itertools.count()
        # Of each connection: who asked it last, and until when its answer may come.
        self.asked: dict[str, tuple[Process, float]] = {}
        self.polls = 0
        self.last_asked: dict[str, float] = {}
        self.doubles: list[str] = []
        # Steps that decided something although none was due.
        self.overslept: list[str] = []
        self.connections: dict[str, Connection] = {}

    def start(self, *zones: str) -> Process:
        random = self.random
        process = Process(
            self,
            random.choice("abc"),
            zones or ("",),
            random.uniform(0.95, 1.05),
            random.uniform(0, 1e6),
        )
        self.processes.append(process)
        self.bucket.watchers.append(process)
        process.watch()
        return process

    def kill(self, process: Process) -> None:
        self.processes.remove(process)
        self.bucket.watchers.remove(process)

    def configure(self, number: int, zone: str = "") -> None:
        """Put a connection into a zone, and into no other one."""
        connection = Connection(zone, f"tcp:192.0.2.{number}:502", TIMEOUT, "[]")
        before = self.connections.get(connection.key)
        self.connections[connection.key] = connection
        self.bucket.write(connection.bucket_key, connection.encode())
        if before is not None and before.bucket_key != connection.bucket_key:
            self.bucket.write(before.bucket_key, None)

    def unconfigure(self, number: int) -> None:
        connection = self.connections.pop(f"tcp:192.0.2.{number}:502", None)
        if connection is not None:
            self.bucket.write(connection.bucket_key, None)

    def later(self, delay: float, put: Put) -> None:
        heapq.heappush(self.writes, (self.now + delay, next(self.order), put))

    def write(self) -> None:
        """Carry out the writes that have arrived."""
        while self.writes and self.writes[0][0] <= self.now:
            self.bucket.put(heapq.heappop(self.writes)[2])

    def run(self, seconds: float) -> None:
        until = self.now + seconds
        while self.now < until:
            self.now += TICK * self.random.uniform(0.2, 1)
            self.write()
            for process in self.random.sample(self.processes, len(self.processes)):
                self.ask(process)
                process.turn()
                self.ask(process)

    def ask(self, process: Process) -> None:
        """Whatever may be asked is asked."""
        if process.is_stopped:
            return
        for key in process.worker.active:
            if process.worker.may_ask(key, process.now):
                self._asked(process, key)

    def _asked(self, process: Process, key: str) -> None:
        self.polls += 1
        self.last_asked[key] = self.now
        other, until = self.asked.get(key, (process, 0.0))
        if other is not process and self.now < until:
            self.doubles.append(f"{self.now:.2f} {key}: {process.worker.id}")
        self.asked[key] = process, self.now + TIMEOUT * 0.9

    def cut_off(self, process: Process, keys: set[str]) -> None:
        """Whoever is asked no more is not waited for, either."""
        for key in keys:
            if self.asked.get(key, (None,))[0] is process:
                del self.asked[key]

    @property
    def unasked(self) -> list[str]:
        """The connections that exist, and were not asked for a while."""
        return [key for key in self.connections if self.last_asked.get(key, 0) < self.now - 1]
