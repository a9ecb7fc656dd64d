"""
A cache of responses to reads. No socket, no clock.
"""

from __future__ import annotations

import math
from collections import OrderedDict

__all__ = ["Cache"]

MOST = 4096
"""The most responses that are kept; the oldest one is dropped for one more."""


class Cache:
    """
    Responses to reads, by unit and request.

    The response to a request that was sent before a write to the same unit is never kept, because
    it may contain older values.
    """

    def __init__(self) -> None:
        self._answers: OrderedDict[tuple[int, bytes], tuple[float, bytes]] = OrderedDict()
        # Unit -> the time of the last write; 0 for a write to all units.
        self._written: dict[int, float] = {}

    def get(self, unit: int, request: bytes, age: float, now: float) -> bytes | None:
        """Return a response that is at most `age` seconds old, or None."""
        found = self._answers.get((unit, request))
        return found[1] if found is not None and now - found[0] <= age else None

    def keep(self, unit: int, request: bytes, answer: bytes, asked: float) -> None:
        """Keep the response to a request that was sent at a time; it is no older."""
        if asked <= max(self._written.get(each, -math.inf) for each in (0, unit)):
            return
        key = unit, request
        self._answers.pop(key, None)
        self._answers[key] = asked, answer
        if len(self._answers) > MOST:
            self._answers.popitem(last=False)

    def forget(self, unit: int, now: float) -> None:
        """Drop the responses of a unit that may be written to; those of all units for unit 0."""
        self._written[unit] = now
        for key in [key for key in self._answers if unit in (0, key[0])]:
            del self._answers[key]
