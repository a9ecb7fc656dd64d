"""
Units that do not answer, and when requests may be sent to them again. No socket, no clock.
"""

from __future__ import annotations

import math
from enum import Enum

from ...client.waiting_room import rest_after

__all__ = ["SilentUnits", "UnitState"]

LONGEST_REST = 30.0


class UnitState(Enum):
    """GOOD: send a request; RESTING: refuse it at once; DUE: let it try the unit."""

    GOOD = "good"
    RESTING = "resting"
    DUE = "due"


class SilentUnits:
    """
    A unit that does not answer rests: for `first_rest` seconds, then twice as long, and so on up
    to `LONGEST_REST`, until it answers. Between two rests the unit is due: one request tries it.

    Args:
        first_rest: seconds; no shorter than the delay of a late response.
    """

    def __init__(self, first_rest: float) -> None:
        self._first = first_rest
        # Unit -> number of missing responses in a row, and the end of its rest.
        self._units: dict[int, tuple[int, float]] = {}

    def __len__(self) -> int:
        return len(self._units)

    def __contains__(self, unit: int) -> bool:
        return unit in self._units

    def state(self, unit: int, now: float) -> UnitState:
        if not self._units or unit not in self._units:
            return UnitState.GOOD
        return UnitState.RESTING if now < self._units[unit][1] else UnitState.DUE

    def start_trial(self, unit: int) -> int:
        """Let a request try the unit, while others are refused; return the misses so far."""
        misses, _ = self._units[unit]
        self._units[unit] = misses, math.inf
        return misses

    def cancel_trial(self, unit: int, now: float) -> None:
        """Let the next request try the unit, because the last one was not sent."""
        if unit in self._units:
            self._units[unit] = self._units[unit][0], now

    def note_answer(self, unit: int) -> bool:
        """Note an answer; return True if the unit was silent before."""
        return self._units.pop(unit, None) is not None

    def note_silence(self, unit: int, now: float) -> bool:
        """Note that a request got no answer in time; return True if the unit was not silent yet."""
        misses, until = self._units.get(unit, (0, 0.0))
        if now < until < math.inf:
            return False  # another request, sent before the unit rested
        self._units[unit] = misses + 1, now + rest_after(misses + 1, self._first, LONGEST_REST)
        return not misses
