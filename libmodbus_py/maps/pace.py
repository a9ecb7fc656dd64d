"""
Which points are read at a poll: those with an interval of their own are read at some polls only.

No clock: times are seconds of any steady clock.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

__all__ = ["PointIntervals"]

TOLERANCE = 0.001
"""The part of the time between two polls that sums of times may be inexact by."""


class PointIntervals:
    """
    The intervals of the points of one device, from poll to poll.

    Polls come at the shortest interval. A point with a longer one is read at the first poll that is
    due when its interval is over, and never sooner. The times at which polls are due count, not
    those at which they begin, so that no poll is left out because the one before began late.

    Args:
        own: the interval of each point; None for one without its own.
        usual: the interval of points without their own, in seconds.

    Attributes:
        interval: seconds from one poll to the next.
    """

    __slots__ = ("_again", "_at", "_due", "_indexes", "_last", "interval")

    def __init__(self, own: Sequence[float | None], usual: float) -> None:
        self._indexes: dict[float, list[int]] = {}
        for at, each in enumerate(own):
            self._indexes.setdefault(usual if each is None else each, []).append(at)
        self.interval: float = min(self._indexes, default=usual)
        # When the poll was due that read the points of an interval last.
        self._last: dict[float, float] = {}
        # Intervals whose points were not answered at the last poll, although others were.
        self._again: set[float] = set()
        self._due: list[float] = []
        self._at = 0.0

    def due(self, at: float) -> tuple[int, ...] | None:
        """
        Return the indexes of the points that are read at a poll; None if all are.

        Args:
            at: when the poll is due.
        """
        self._at = at
        over = at + self.interval * TOLERANCE
        self._due = [
            each
            for each in self._indexes
            if each == self.interval or self._last.get(each, -math.inf) + each <= over
        ]
        if len(self._due) == len(self._indexes):
            return None
        return tuple(sorted(at for each in self._due for at in self._indexes[each]))

    def done(self, unanswered: Collection[int] = ()) -> None:
        """
        Note that what was due is read.

        Points without an answer are read again at the next poll, once; if there was no answer at
        all, until there is one.

        Args:
            unanswered: the indexes of the points that the device did not answer for.
        """
        missing = set(unanswered)
        if missing and all(missing.issuperset(self._indexes[each]) for each in self._due):
            return
        for each in self._due:
            if each not in self._again and not missing.isdisjoint(self._indexes[each]):
                self._again.add(each)
                continue
            self._again.discard(each)
            self._last[each] = self._at
