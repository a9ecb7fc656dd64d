"""
The last numbers of a value with their times, in few bytes.
"""

from __future__ import annotations

import math
import sys
from array import array
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

__all__ = [
    "MOST_BYTES",
    "MOST_PAIRS",
    "MOST_SAMPLES",
    "Samples",
    "charted",
    "samples_of_each",
    "thinned",
]

MOST_SAMPLES = 600
"""The most samples of one value; with one sample a second, those of ten minutes."""

FEWEST = 60
"""The samples that each value may have, however many values there are."""

MOST_BYTES = 64_000_000
"""The most bytes of the samples of all values; a sample takes 16 bytes."""

MOST_PAIRS = 1000
"""The most samples of a chart."""

# A sample replaces the previous one if fewer seconds lie between them.
SHORTEST = 0.4

NUMBERS = (float, int, bool)

GREATEST = sys.float_info.max

# Levels of a sparkline.
LEVELS = 20

Pairs = list[tuple[float, "float | None"]]


def samples_of_each(count: int) -> int:
    """Return how many samples each of so many values may have."""
    return max(FEWEST, min(MOST_SAMPLES, MOST_BYTES // 16 // max(1, count)))


class Samples:
    """
    The last samples of one value; a value that is not a number, or is missing, is a gap.

    Args:
        most: the most samples that are kept, at least 2.

    Attributes:
        low, high: the lowest and the highest number since the first sample; None if there is none.
    """

    __slots__ = ("_at", "_most", "_newest", "_times", "_values", "high", "low")

    def __init__(self, most: int = MOST_SAMPLES) -> None:
        self.low: float | None = None
        self.high: float | None = None
        self._most = most
        self._at = 0
        self._newest = -math.inf
        self._times = array("d")
        self._values = array("d")

    def __len__(self) -> int:
        return len(self._times)

    def add(self, time: float, value: Any) -> None:
        """Keep a sample; a value that is not a finite number is a gap."""
        number = math.nan
        if type(value) in NUMBERS and -GREATEST <= value <= GREATEST:
            number = value
            if self.low is None or self.high is None:
                self.low = self.high = number
            elif number < self.low:
                self.low = number
            elif number > self.high:
                self.high = number
        self._keep(time, number)

    def _keep(self, time: float, number: float) -> None:
        times, at = self._times, self._at
        if 0 <= time - self._newest < SHORTEST:
            if number == number:  # a gap must not replace a number
                self._values[at - 1] = number
            return
        self._newest = time
        if len(times) < self._most:
            self._values.append(number)
            times.append(time)
        else:
            self._values[at] = number
            times[at] = time
            self._at = (at + 1) % self._most

    def resize(self, most: int) -> None:
        """Set the most samples that are kept; the oldest ones are dropped."""
        if most != self._most:
            at, self._most, self._at = self._at, most, 0
            self._times = (self._times[at:] + self._times[:at])[-most:]
            self._values = (self._values[at:] + self._values[:at])[-most:]

    def pairs(self, since: float = -math.inf) -> Pairs:
        """Return time and number of each sample after a time, the oldest first; None for a gap."""
        at = self._at
        times = self._times[at:] + self._times[:at]
        values = self._values[at:] + self._values[:at]
        found = [
            (time, value if value == value else None)
            for time, value in zip(times, values, strict=False)
            if time > since
        ]
        # The clock may have been set back.
        return found if all(a[0] <= b[0] for a, b in pairwise(found)) else sorted(found, key=_time)

    def spark(self, count: int) -> list[int]:
        """Return the last samples as levels from 0 to 20, and -1 for each gap."""
        at, held = self._at, self._values
        values = held[max(0, at - count) : at] if at >= count else (held[at:] + held[:at])[-count:]
        numbers = [each for each in values if each == each]
        if not numbers:
            return []
        low = min(numbers)
        span = max(numbers) - low
        if not 0 < span < math.inf:
            return [LEVELS // 2 if each == each else -1 for each in values]
        by = LEVELS / span
        return [int((each - low) * by) if each == each else -1 for each in values]


def charted(pairs: Pairs, now: float, units: str, *, is_stepped: bool = False) -> dict[str, Any]:
    """Return samples as JSON for a chart."""
    kept = thinned(pairs, MOST_PAIRS)
    return {
        "now": now,
        "times": [round(at, 2) for at, _ in kept],
        "values": [each for _, each in kept],
        "units": units,
        "is_stepped": is_stepped,
    }


def _time(pair: tuple[float, Any]) -> float:
    return pair[0]


def thinned(pairs: Sequence[tuple[float, float | None]], most: int) -> Pairs:
    """
    Return a limited number of samples: the extremes of each stretch of time, and every gap.

    Args:
        pairs: time and number of each sample, the oldest first; None for a gap.
        most: the most samples to return, at least 4.
    """
    if len(pairs) <= most:
        return list(pairs)
    length = -(-len(pairs) // (most // 4))
    found: Pairs = []
    for start in range(0, len(pairs), length):
        stretch = pairs[start : start + length]
        numbers = [(value, at) for at, (_, value) in enumerate(stretch) if value is not None]
        gap = next((at for at, (_, value) in enumerate(stretch) if value is None), None)
        kept = {0, *(at for _, at in (min(numbers), max(numbers)))} if numbers else {0}
        found += [stretch[at] for at in sorted(kept | ({gap} if gap is not None else set()))]
    return found
