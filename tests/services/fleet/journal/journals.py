"""What tests of journals share."""

import asyncio
import queue
import sqlite3
from collections.abc import Callable
from contextlib import closing
from typing import Any

import pytest

from libmodbus_py import Fleet
from libmodbus_py.fleet import Journal, Reading
from libmodbus_py.services.fleet.journal.schema import JournalPoll, numbered
from libmodbus_py.services.fleet.statistics import JournalStatistics
from tests.services.fleet.fleets import Peer, meter, simulated_run
from tests.simulation.network import Network


class Inline:
    """A `WriterThread` without a thread: in simulated time a disk takes none."""

    def __init__(self, name: str) -> None:
        self.is_running = False
        self.jobs: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def start(self) -> None:
        self.is_running = True

    def stop(self) -> None:
        self.is_running = False

    async def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        await asyncio.sleep(0)
        return function(*arguments)


def readings(device: str = "a", time: float = 100.0, count: int = 2) -> list[Reading]:
    """The readings of a poll."""
    return [Reading(time, device, f"p{at}", 0.1 * at, "V", "good") for at in range(count)]


def polls(first: int, count: int, size: int = 2, time: float = 100.0) -> list[JournalPoll]:
    """Polls with ids from `first` on, one each second."""
    batches: list[JournalPoll] = []
    for at in range(count):
        [poll] = numbered(readings("a", time + at, size), first + at * size)
        batches.append(poll)
    return batches


def query(path: str, sql: str) -> list[tuple[Any, ...]]:
    """Return the rows that a question gives."""
    with closing(sqlite3.connect(path)) as database:
        return database.execute(sql).fetchall()


def in_journal(path: str) -> list[int]:
    return [number for (number,) in query(path, "SELECT id FROM reading ORDER BY id")]


def journal_of(fleet: Fleet) -> JournalStatistics:
    assert fleet.statistics.journal is not None
    return fleet.statistics.journal


def run_for(path: str, seconds: float, *outputs: Any, change: Any = None) -> Fleet:
    """Poll a device each 10 s, for simulated seconds."""

    async def go() -> Fleet:
        async with Peer() as peer:
            fleet = Fleet(
                [meter("a", peer.url, interval=10)], outputs=outputs, journal=Journal(path)
            )
            async with fleet:
                await asyncio.sleep(seconds)
                if change is not None:
                    await change(fleet)
            return fleet

    return simulated_run(go(), Network())


class Failing:
    """Lets calls of a method, or of a function, fail while `error` is set."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, kind: object, name: str) -> None:
        self.error: Exception | None = None
        self.calls = 0
        original = getattr(kind, name)

        def call(*arguments: Any) -> Any:
            self.calls += 1
            if self.error is not None:
                raise self.error
            return original(*arguments)

        monkeypatch.setattr(kind, name, call)
