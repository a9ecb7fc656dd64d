"""
The times of polls. There is no clock here: times are seconds of any monotonic clock.
"""

from __future__ import annotations

from hashlib import blake2b
from heapq import heappop, heappush
from typing import Generic, TypeVar

__all__ = ["Timetable", "first_time", "next_time"]


def first_time(name: str, interval: float, now: float, wall: float) -> float:
    """
    Return the first time of a device, `wall` being the time of day now, in seconds since the epoch.

    Its phase is derived from its name and the time of day, so that every machine polls it at the
    same moments, and thousands are never polled at once.
    """
    digest = blake2b(name.encode(), digest_size=8).digest()
    phase = int.from_bytes(digest, "big") / 2**64 * interval
    return now + (phase - wall) % interval


def next_time(planned: float, interval: float, now: float) -> tuple[float, int]:
    """Return the first time after now, and how many earlier times are skipped."""
    missed = max(0, int((now - planned) // interval))
    return planned + (missed + 1) * interval, missed


Each = TypeVar("Each")


class Timetable(Generic[Each]):
    """A priority queue of thousands of members by time; each has one place in it."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, Each]] = []
        self._places: dict[Each, int] = {}
        self._number = 0

    def __len__(self) -> int:
        return len(self._places)

    def put(self, each: Each, at: float) -> None:
        """Add a member, or move it to another time."""
        self._number += 1
        self._places[each] = self._number
        heappush(self._heap, (at, self._number, each))

    def remove(self, each: Each) -> None:
        """Remove a member, if it is there."""
        self._places.pop(each, None)
        if len(self._heap) > 2 * len(self._places) + 100:
            self._heap = [entry for entry in self._heap if self._places.get(entry[2]) == entry[1]]
            self._heap.sort()

    @property
    def next_at(self) -> float | None:
        """The earliest time; None without members."""
        self._drop_old()
        return self._heap[0][0] if self._heap else None

    def due(self, now: float, most: int) -> list[tuple[float, Each]]:
        """Remove and return up to `most` members that are due, with their times."""
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
