"""
When devices are polled. No clock of its own: times are seconds of any steady one.
"""

from __future__ import annotations

from hashlib import blake2b
from heapq import heappop, heappush
from typing import Generic, TypeVar

__all__ = ["Timetable", "first_time", "next_time"]


def first_time(name: str, interval: float, now: float, wall: float) -> float:
    """
    Give the first time of a device: its phase comes of its name and of the time of day, so it
    is polled at the same moments by whatever machine does, and thousands never all at once.

    Args:
        now: the time now.
        wall: and the same moment in seconds since the epoch.
    """
    digest = blake2b(name.encode(), digest_size=8).digest()
    phase = int.from_bytes(digest, "big") / 2**64 * interval
    return now + (phase - wall) % interval


def next_time(planned: float, interval: float, now: float) -> tuple[float, int]:
    """Give the first time after now, and how many before it are skipped, for they have passed."""
    missed = max(0, int((now - planned) // interval))
    return planned + (missed + 1) * interval, missed


Each = TypeVar("Each")


class Timetable(Generic[Each]):
    """What is due when, for thousands: one heap, and one place in it for each."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, Each]] = []
        self._places: dict[Each, int] = {}
        self._number = 0

    def __len__(self) -> int:
        return len(self._places)

    def put(self, each: Each, at: float) -> None:
        """Have it due then, and not when it was to be before."""
        self._number += 1
        self._places[each] = self._number
        heappush(self._heap, (at, self._number, each))

    def remove(self, each: Each) -> None:
        """It is not due any more, if it was."""
        self._places.pop(each, None)
        if len(self._heap) > 2 * len(self._places) + 100:
            self._heap = [entry for entry in self._heap if self._places.get(entry[2]) == entry[1]]
            self._heap.sort()

    @property
    def next_at(self) -> float | None:
        """When somebody is due."""
        self._drop_old()
        return self._heap[0][0] if self._heap else None

    def due(self, now: float, most: int) -> list[tuple[float, Each]]:
        """Take out who is due, so many at most, with their times."""
        found: list[tuple[float, Each]] = []
        while self._heap and self._heap[0][0] <= now and len(found) < most:
            at, number, each = heappop(self._heap)
            if self._places.get(each) == number:
                del self._places[each]
                found.append((at, each))
        return found

    def _drop_old(self) -> None:
        heap = self._heap
        while heap and self._places.get(heap[0][2]) != heap[0][1]:
            heappop(heap)
