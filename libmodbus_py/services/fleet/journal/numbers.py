"""
The ids of readings: never given twice, also after a crash, after the clock was set, or in another
file. Ids of readings that were never journalled are missing.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable

__all__ = ["Unused", "first_id"]

# More readings than can be sent to outputs, and be lost in a crash before they are on the disk.
MARGIN = 10_000_000


def first_id(now: float, last: int) -> int:
    """
    Return the first id of a run.

    It is the time in microseconds: a journal that replaces a deleted one has greater ids too,
    because a fleet has less than a million readings a second.

    Args:
        now: seconds since the epoch, by a clock that may be wrong.
        last: the greatest id that the journal contains; 0 if it is new.
    """
    return max(int(now * 1e6), last + MARGIN if last else 1)


class Unused:
    """
    The ids that no reading has: at the beginning of each run some are left out.

    Args:
        runs: the first id of each run, and how many before it are left out, in order.
    """

    def __init__(self, runs: Iterable[tuple[int, int]] = ()) -> None:
        self._first: list[int] = []
        self._unused: list[int] = []
        self._sums: list[int] = [0]
        for first, unused in runs:
            self.add(first, unused)

    def add(self, first: int, unused: int) -> None:
        """Note a run."""
        self._first.append(first)
        self._unused.append(unused)
        self._sums.append(self._sums[-1] + unused)

    def between(self, after: int, last: int) -> int:
        """Return the number of readings that have ids above `after`, up to `last`."""
        return max(0, self._used(last) - self._used(after))

    def _used(self, number: int) -> int:
        at = bisect_right(self._first, number)
        unused = self._sums[at]
        if at < len(self._first):  # the id may be one of those left out before the next run
            unused += max(0, number - (self._first[at] - self._unused[at]) + 1)
        return number - unused
