"""
Units that gave no answer: when they may be asked again. No socket, no clock.
"""

from __future__ import annotations

import math
from enum import Enum

__all__ = ["SilentUnits", "Standing"]

LONGEST_PAUSE = 30.0


class Standing(Enum):
    """How a unit stands."""

    GOOD = "good"
    RESTING = "resting"
    DUE = "due"


class SilentUnits:
    """
    A unit that gave no answer rests: for `first_pause` seconds, then twice as long, and so on up
    to `LONGEST_PAUSE`, until it answers. Between two rests it is due: one request tries it.

    Args:
        first_pause: seconds; no less than a late answer may take.
    """

    def __init__(self, first_pause: float) -> None:
        self._first = first_pause
        # Unit -> its pause, and when that is over.
        self._units: dict[int, tuple[float, float]] = {}

    def __len__(self) -> int:
        return len(self._units)

    def __contains__(self, unit: int) -> bool:
        return unit in self._units

    def standing(self, unit: int, now: float) -> Standing:
        if not self._units or unit not in self._units:
            return Standing.GOOD
        return Standing.RESTING if now < self._units[unit][1] else Standing.DUE

    def note_trial(self, unit: int) -> None:
        """A request tries it: no other one does meanwhile."""
        pause, _ = self._units[unit]
        self._units[unit] = pause, math.inf

    def note_untried(self, unit: int, now: float) -> None:
        """The request that was to try it did not; the next one may."""
        if unit in self._units:
            self._units[unit] = self._units[unit][0], now

    def note_answer(self, unit: int) -> bool:
        """It is there; says whether it was not before."""
        return self._units.pop(unit, None) is not None

    def note_silence(self, unit: int, now: float) -> bool:
        """It gave no answer in time, or not as long as it was waited for; says if that is new."""
        pause, until = self._units.get(unit, (0.0, 0.0))
        if now < until < math.inf:
            return False  # another request, asked before it rested
        longer = min(2 * pause, max(LONGEST_PAUSE, self._first)) or self._first
        self._units[unit] = longer, now + longer
        return not pause
