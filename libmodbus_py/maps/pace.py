"""
Which points are read at a poll: those with an interval of their own are read at some polls only.

No clock: times are seconds of any steady clock.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

__all__ = ["PointIntervals"]


class PointIntervals:
    """
    The intervals of the points of one device, from poll to poll.

    Polls come at the shortest interval. A longer interval ends at the poll that is nearest to its
    end, so that the points of several intervals share requests; it does not drift.

    Args:
        own: the interval of each point; None for one without its own.
        usual: the interval of points without their own, in seconds.

    Attributes:
        interval: seconds from one poll to the next.
    """

    __slots__ = ("_again", "_due", "_indexes", "_next", "_now", "interval")

    def __init__(self, own: Sequence[float | None], usual: float) -> None:
        self._indexes: dict[float, list[int]] = {}
        for at, each in enumerate(own):
            self._indexes.setdefault(usual if each is None else each, []).append(at)
        self.interval: float = min(self._indexes, default=usual)
        self._next: dict[float, float] = {}
        # Intervals whose points were not answered at the last poll, although others were.
        self._again: set[float] = set()
        self._due: list[float] = []
        self._now = 0.0

    def due(self, now: float) -> tuple[int, ...] | None:
        """Return the indexes of the points that are read now; None if all are."""
        self._now = now
        nearest = now + self.interval / 2
        self._due = [
            each
            for each in self._indexes
            if each == self.interval or self._next.get(each, now) <= nearest
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
            planned = self._next.get(each, self._now)
            passed = max(0.0, self._now + self.interval / 2 - planned)
            self._next[each] = planned + (passed // each + 1) * each
