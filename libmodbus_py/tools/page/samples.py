"""
The last numbers of a value with their times, in few bytes, and numbers computed from counters.

Where there is no number, there is a gap: a sample without a number is one, and so is a time without
samples, if the time between two samples is known. A chart draws no line across a gap.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from array import array
from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Any, NamedTuple

# Samples of one value: with one a second, those of ten minutes; and however many values there are.
MOST_SAMPLES = 600
FEWEST = 60

# Bytes of the samples of all values, each of which takes 16 bytes.
MOST_BYTES = 64_000_000

# The most samples of a sparkline, which is as many pixels wide, and its levels.
SPARK = 60
LEVELS = 20

# Seconds between two samples; a sample that comes sooner replaces the previous one.
SHORTEST = 0.4

# Intervals without a sample that are a gap; a poll may be late, or left out once.
GAP = 3

Pairs = list[tuple[float, "float | None"]]
"""Time and number of samples; None for a gap."""


def samples_of_each(count: int) -> int:
    """Return how many samples each of so many values may have."""
    return max(FEWEST, min(MOST_SAMPLES, MOST_BYTES // 16 // max(1, count)))


def _is_number(value: object) -> bool:
    most = sys.float_info.max
    return type(value) in (float, int, bool) and -most <= value <= most  # type: ignore[operator]


def _is_gap(seconds: float, every: float | None) -> bool:
    return every is not None and seconds > GAP * max(every, SHORTEST)


class Samples:
    """The last samples of one value, and the lowest and highest number since the first."""

    __slots__ = ("_most", "_numbers", "every", "high", "low", "newest")

    def __init__(self, every: float | None = None, most: int = MOST_SAMPLES) -> None:
        self.every: float | None = every  # seconds; None if a number is valid until the next one
        self.newest: float = -math.inf
        self.low: float | None = None
        self.high: float | None = None
        self._most = most
        self._numbers = array("d")  # times and numbers in turn: a thread copies both at once

    def add(self, time: float, value: Any) -> None:
        """Keep a sample; a value that is not a finite number is a gap."""
        number = math.nan
        if _is_number(value):
            number = value
            self.low = number if self.low is None else min(self.low, number)
            self.high = number if self.high is None else max(self.high, number)
        seconds = time - self.newest
        if 0 <= seconds < SHORTEST:
            if number == number:  # a gap must not replace a number
                self._numbers[-1] = number
            return
        last = self._numbers[-1] if self._numbers else math.nan
        if last == last and _is_gap(seconds, self.every):
            self._numbers.extend((self.newest + SHORTEST, math.nan))
        self.newest = time
        self._numbers.extend((time, number))
        self.resize(self._most)

    def resize(self, most: int) -> None:
        """Set the most samples that are kept; the oldest ones are dropped."""
        self._most = most
        del self._numbers[: -2 * most]

    def pairs(self, since: float = -math.inf) -> Pairs:
        """Return the samples after a time in its order, also if the clock was set back."""
        numbers = self._numbers[:]
        samples = [
            (time, value if value == value else None)
            for time, value in zip(numbers[::2], numbers[1::2], strict=True)
            if time > since
        ]
        return sorted(samples, key=lambda sample: sample[0])

    def spark(self) -> list[int]:
        """Return the last samples as levels from 0 to 20, and -1 for each gap."""
        values = self._numbers[-2 * SPARK :][1::2]
        numbers = [value for value in values if value == value]
        if not numbers:
            return []
        low = min(numbers)
        span = max(numbers) - low
        if not 0 < span < math.inf:  # all are equal, or too far apart
            return [LEVELS // 2 if value == value else -1 for value in values]
        by = LEVELS / span
        return [int((value - low) * by) if value == value else -1 for value in values]


class Series(NamedTuple):
    """The numbers that a chart shows, and their units of measurement."""

    samples: Samples
    units: str


def chart_of(pairs: Pairs, now: float, units: str, every: float | None) -> dict[str, Any]:
    """Return the samples up to now as JSON for a chart; `every` as for `Samples`."""
    past = [(at, value) for at, value in pairs if at <= now]
    return {
        "now": now,
        "times": [round(at, 2) for at, _ in past],
        "values": [value if _is_number(value) else None for _, value in past],
        "units": units,
        "is_stepped": every is None,
    }


def with_gaps(pairs: Pairs, every: float | None) -> Pairs:
    """Return samples, in the order of their times, with a gap where one is missing."""
    result = pairs[:1]
    for before, after in pairwise(pairs):
        if _is_gap(after[0] - before[0], every) and None not in (before[1], after[1]):
            result.append((before[0] + SHORTEST, None))
        result.append(after)
    return result


# --- numbers computed from counters ---------------------------------------------------------------

# Seconds between two samples of counters.
SAMPLED = 1.0

UNITS = {"rate": "requests/s", "time": "ms", "queue": "requests"}

Name = tuple[str, str]


class Counts(NamedTuple):
    """Counters of a row: its responses took so many seconds; `waiting` is None if none can."""

    requests: int
    answers: int = 0
    seconds: float = 0.0
    waiting: int | None = None


def _figures(before: Counts, now: Counts, seconds: float) -> dict[str, float | None]:
    answers = now.answers - before.answers
    took = round((now.seconds - before.seconds) / answers * 1000, 2) if answers > 0 else None
    rate = round(max(0, now.requests - before.requests) / seconds, 2)
    return {"rate": rate, "time": took, "queue": now.waiting}


class RowHistory:
    """Samples the counters of rows, at most once a second; safe from any thread."""

    def __init__(
        self,
        counts: Callable[[], Iterable[tuple[Name, Counts]]],
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._counts = counts
        self._clock = clock
        self._lock = threading.Lock()
        self._rows: dict[Name, tuple[Counts, dict[str, Samples]]] = {}
        self._at = 0.0

    def sample(self) -> None:
        """Take a sample, unless the last one is less than a second old."""
        now = self._clock()
        if 0 <= now - self._at < SAMPLED or not self._lock.acquire(blocking=False):
            return
        try:
            seconds, self._at = now - self._at, now
            rows = dict(self._counts())
            most = samples_of_each(len(rows) * len(UNITS))
            self._rows = {
                name: self._row(name, counts, now, seconds, most) for name, counts in rows.items()
            }
        finally:
            self._lock.release()

    def _row(
        self, name: Name, counts: Counts, now: float, seconds: float, most: int
    ) -> tuple[Counts, dict[str, Samples]]:
        if name not in self._rows:
            return counts, {column: Samples(SAMPLED, most) for column in UNITS}
        before, series = self._rows[name]
        if seconds > 0:
            for column, figure in _figures(before, counts, seconds).items():
                series[column].resize(most)
                series[column].add(now, figure)
        return counts, series

    def spark(self, name: Name, column: str) -> list[int]:
        """Return the last numbers of a row as levels; an empty list if there are none."""
        series = self.series(name, column)
        return [] if series is None else series.samples.spark()

    def series(self, name: Name, column: str) -> Series | None:
        """Return the numbers of a row; None if there is no such row or column."""
        former = self._rows.get(name)
        if former is None or column not in former[1]:
            return None
        return Series(former[1][column], UNITS[column])
