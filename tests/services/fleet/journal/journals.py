"""
What tests of journals share.
"""

from __future__ import annotations

import asyncio
import queue
from collections.abc import Callable
from typing import Any

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.journal.schema import JournalPoll, numbered


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
    told: list[JournalPoll] = []
    for at in range(count):
        [poll] = numbered(readings("a", time + at, size), first + at * size)
        told.append(poll)
    return told
