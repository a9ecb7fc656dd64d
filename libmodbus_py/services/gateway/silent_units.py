"""
Silent units and functions, and when requests may be sent to them again. No socket, no clock.

1. A unit that gives no answer rests until it answers, twice as long each time, up to
   `LONGEST_REST_S`. A function rests alone while the unit answers others, because devices leave
   functions that they do not know without an answer.
2. At the end of a rest one request tries the unit. The function that got no answer last rests
   twice as long as the others, because the unit may answer only those.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from ..line import rest_after

LONGEST_REST_S = 15.0
"""The longest rest between two trials, unless the first one is longer."""


class UnitState(Enum):
    """GOOD: send a request; RESTING: refuse it at once; DUE: let it try the unit."""

    GOOD = "good"
    RESTING = "resting"
    DUE = "due"


@dataclass(slots=True)
class Rest:
    """A rest of so many seconds, and the function that got no answer last."""

    function: int
    misses: int = 0
    length: float = 0.0
    until: float = -math.inf  # infinite while a request tries

    def end_for(self, function: int) -> float:
        return self.until + (self.length if function == self.function else 0.0)


class SilentUnits:
    """Units and functions that rest, for `first_rest` seconds at first."""

    def __init__(self, first_rest: float) -> None:
        self._first_rest = first_rest
        # Of a whole unit, whose function is None here, or of one function of a unit.
        self._rests: dict[tuple[int, int | None], Rest] = {}
        # The units, and functions of them, whose last request was answered: nothing of these rests.
        self._answered_functions: set[tuple[int, int]] = set()

    def rests(self, unit: int) -> bool:
        """Return True if the whole unit is silent."""
        return (unit, None) in self._rests

    def state(self, unit: int, function: int, now: float) -> UnitState:
        if (unit, function) in self._answered_functions:
            return UnitState.GOOD
        rest = self._rest(unit, function)
        if rest is None:
            return UnitState.GOOD
        return UnitState.RESTING if now < rest.end_for(function) else UnitState.DUE

    def start_trial(self, unit: int, function: int) -> int:
        """Let a request try what is due, while others are refused; return the misses so far."""
        rest = self._rest(unit, function)
        assert rest is not None
        rest.until = math.inf
        return rest.misses

    def cancel_trial(self, unit: int, function: int, now: float) -> None:
        """Let the next request try, because the last one was not sent."""
        rest = self._rest(unit, function)
        if rest is not None and rest.until == math.inf:
            rest.until = now - rest.length

    def note_answer(self, unit: int, function: int) -> bool:
        """Note an answer; return True if the unit or the function was silent before."""
        if (unit, function) in self._answered_functions:
            return False
        self._answered_functions.add((unit, function))
        if not self.rests(unit):
            return self._rests.pop((unit, function), None) is not None
        # What was silent together with the unit may answer again together with it.
        self._rests = {key: rest for key, rest in self._rests.items() if key[0] != unit}
        return True

    def note_silence(self, unit: int, function: int, now: float) -> bool:
        """Note that no answer came in time; return True if what rests now did not rest before."""
        self._answered_functions.discard((unit, function))
        is_whole = all(other != unit for other, _ in self._answered_functions)
        rest = self._rests.setdefault((unit, None if is_whole else function), Rest(function))
        if now < rest.end_for(rest.function) < math.inf:
            return False  # it was sent before the rest began
        rest.misses += 1
        rest.length = rest_after(rest.misses, self._first_rest, LONGEST_REST_S)
        rest.until, rest.function = now + rest.length, function
        return rest.misses == 1

    def _rest(self, unit: int, function: int) -> Rest | None:
        return self._rests.get((unit, None)) or self._rests.get((unit, function))
