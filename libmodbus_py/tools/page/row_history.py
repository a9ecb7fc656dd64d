"""
The numbers of the rows of a table over time, computed from counters that only increase.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Generic, TypeVar

from .samples import Samples, samples_of_each
from .tables import SPARK, Series

__all__ = ["RowHistory"]

# Seconds between two samples.
SAMPLED = 1.0

Row = TypeVar("Row")
Counts = TypeVar("Counts")
Name = tuple[str, str]
Figures = Mapping[str, float | None]


class RowHistory(Generic[Row, Counts]):
    """
    Samples numbers of rows, at most once a second. Safe from any thread.

    Args:
        rows: returns the name of each row, as in its first cell, and the row.
        count: returns the counters of a row.
        figures: returns the numbers of a row, by the titles of their columns; called with its
            previous and current counters, and the seconds between them. None means no number.
        units: the units of each of these columns.
        clock: returns seconds since the epoch.
    """

    def __init__(
        self,
        rows: Callable[[], Iterable[tuple[Name, Row]]],
        count: Callable[[Row], Counts],
        figures: Callable[[Counts, Counts, float], Figures],
        units: Mapping[str, str],
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._rows = rows
        self._count = count
        self._figures = figures
        self._units = units
        self._clock = clock
        self._lock = threading.Lock()
        self._known: dict[Name, tuple[Counts, dict[str, Samples]]] = {}
        self.at: float = 0.0

    def sample(self) -> None:
        """Take a sample, unless the last one is less than a second old."""
        now = self._clock()
        if 0 <= now - self.at < SAMPLED or not self._lock.acquire(blocking=False):
            return
        try:
            self._sample(now)
        finally:
            self._lock.release()

    def _sample(self, now: float) -> None:
        passed, self.at = now - self.at, now
        before, after = self._known, dict[Name, tuple[Counts, dict[str, Samples]]]()
        rows = list(self._rows())
        most = samples_of_each(len(rows) * len(self._units))
        for name, row in rows:
            counts = self._count(row)
            known = before.get(name)
            series = (
                {column: Samples(most) for column in self._units} if known is None else known[1]
            )
            if known is not None and passed > 0:
                for column, figure in self._figures(known[0], counts, passed).items():
                    series[column].resize(most)
                    series[column].add(now, figure)
            after[name] = counts, series
        self._known = after

    def spark(self, name: Name, column: str) -> list[int]:
        """Return the last numbers of a row as levels; an empty list if there are none."""
        known = self._known.get(name)
        return [] if known is None else known[1][column].spark(SPARK)

    def series(self, name: Name, column: str) -> Series | None:
        """Return the numbers of a row; None if there is no such row or column."""
        known = self._known.get(name)
        if known is None or column not in known[1]:
            return None
        return Series(known[1][column], self._units[column])
