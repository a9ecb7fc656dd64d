"""
Silent units and functions, and when requests may be sent to them again. No socket, no clock.
"""

from __future__ import annotations

import math
from enum import Enum

from ..line import rest_after

__all__ = ["SilentUnits", "UnitState"]

LONGEST_REST_S = 30.0
"""The longest rest between two trials, unless the first one is longer."""


class UnitState(Enum):
    """GOOD: send a request; RESTING: refuse it at once; DUE: let it try the unit."""

    GOOD = "good"
    RESTING = "resting"
    DUE = "due"


class Rest:
    """
    The rest of a unit, or of one function of a unit.

    Attributes:
        misses: number of missing responses in a row.
        until: its end; infinite while a request tries.
        length: in seconds.
        function: the function that got no answer last.
        others_wait: True if requests with another function were refused since then.
    """

    __slots__ = ("function", "length", "misses", "others_wait", "until")

    def __init__(self, function: int) -> None:
        self.misses: int = 0
        self.until: float = 0.0
        self.length: float = 0.0
        self.function: int = function
        self.others_wait: bool = False

    def state(self, function: int, now: float) -> UnitState:
        if now >= self.until:
            # The unit may answer the others only.
            if not (function == self.function and self.others_wait):
                return UnitState.DUE
            return UnitState.RESTING if now < self.until + self.length else UnitState.DUE
        if function != self.function:
            self.others_wait = True
        return UnitState.RESTING

    def note_silence(self, function: int, now: float, first: float) -> bool:
        """Note a missing response; return False if its request was sent before the rest began."""
        if now < self.until < math.inf:
            return False
        self.misses += 1
        self.length = rest_after(self.misses, first, LONGEST_REST_S)
        self.until = now + self.length
        self.function = function
        self.others_wait = False
        return True


class SilentUnits:
    """
    A unit that gives no answer rests: for `first_rest` seconds, then twice as long, and so on up to
    `LONGEST_REST_S`, until it answers. Between two rests it is due: one request tries it.

    A function rests while the unit answers another one, because devices leave functions that
    they do not know without an answer. When none of the functions that it answered is answered
    any more, the unit rests.

    Args:
        first_rest: seconds; no shorter than the delay of a late response.

    """

    def __init__(self, first_rest: float) -> None:
        self._first = first_rest
        self._units: dict[int, Rest] = {}
        self._functions: dict[tuple[int, int], Rest] = {}
        # The units, and functions of them, whose last request was answered: nothing of these rests.
        self._answering: set[tuple[int, int]] = set()

    def rests(self, unit: int) -> bool:
        """Return True if the whole unit is silent."""
        return unit in self._units

    def state(self, unit: int, function: int, now: float) -> UnitState:
        if (unit, function) in self._answering:
            return UnitState.GOOD
        rest = self._rest(unit, function)
        return UnitState.GOOD if rest is None else rest.state(function, now)

    def start_trial(self, unit: int, function: int) -> int:
        """Let a request try what is due, while others are refused; return the misses so far."""
        rest = self._rest(unit, function)
        assert rest is not None
        rest.until = math.inf
        return rest.misses

    def cancel_trial(self, unit: int, function: int, now: float) -> None:
        """Let the next request try, because the last one was not sent."""
        for rest in (self._units.get(unit), self._functions.get((unit, function))):
            if rest is not None and rest.until == math.inf:
                rest.until, rest.others_wait = now, False

    def note_answer(self, unit: int, function: int) -> bool:
        """Note an answer; return True if the unit or the function was silent before."""
        if (unit, function) in self._answering:
            return False
        self._answering.add((unit, function))
        if self._units.pop(unit, None) is None:
            return self._functions.pop((unit, function), None) is not None
        # What was silent together with the unit may answer again together with it.
        for key in [key for key in self._functions if key[0] == unit]:
            del self._functions[key]
        return True

    def note_silence(self, unit: int, function: int, now: float) -> bool:
        """
        Note that a request got no answer in time.

        Returns:
            True if the unit, or the function of a unit that answers others, was not silent yet.
        """
        self._answering.discard((unit, function))
        if any(each == unit for each, _ in self._answering):
            rest = self._functions.setdefault((unit, function), Rest(function))
        else:
            rest = self._units.setdefault(unit, Rest(function))
        return rest.note_silence(function, now, self._first) and rest.misses == 1

    def _rest(self, unit: int, function: int) -> Rest | None:
        return self._units.get(unit) or self._functions.get((unit, function))
