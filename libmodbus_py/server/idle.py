"""
The order in which connections have been idle, of all or of one address.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Generic, TypeVar

__all__ = ["Idle"]

Each = TypeVar("Each")


class Idle(Generic[Each]):
    """
    Connections in the order in which they are closed to make room: those that never
    sent a request, then the others; the longest idle first in each group.

    Attributes:
        strangers: connections without a request -> the time at which they came.
        known: the others -> the time of their last request.
    """

    __slots__ = ("known", "strangers")

    def __init__(self) -> None:
        self.strangers: dict[Each, float] = {}
        self.known: dict[Each, float] = {}

    def __len__(self) -> int:
        return len(self.strangers) + len(self.known)

    def __iter__(self) -> Iterator[Each]:
        yield from self.strangers
        yield from self.known

    def add(self, each: Each, now: float) -> None:
        self.strangers[each] = now

    def note_request(self, each: Each, now: float) -> None:
        """Make a connection the latest of all."""
        self.remove(each)
        self.known[each] = now

    def remove(self, each: Each) -> None:
        self.strangers.pop(each, None)
        self.known.pop(each, None)

    def due(self, until: float) -> list[Each]:
        """Return the connections that have been idle since a time, or longer."""
        return [*due(self.strangers, until), *due(self.known, until)]


def due(times: dict[Each, float], until: float) -> list[Each]:
    """Return the first ones up to a time; the times are in order."""
    found = []
    for each, time in times.items():
        if time > until:
            break
        found.append(each)
    return found
