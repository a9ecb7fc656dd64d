"""
Silent units and functions, and when requests may be sent to them again. No socket, no clock.

1. A unit that gives no answer gets no requests for a pause, which doubles each time, up to
   `LONGEST_PAUSE_S`. A function is paused alone while the unit answers others, because devices
   leave functions that they do not know without an answer.
2. At the end of a pause one request tries the unit. The pause of the function that got no answer
   last is twice as long, because the unit may answer only the others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from ..line import pause_after

LONGEST_PAUSE_S = 15.0
"""The longest pause between two trials, unless the first one is longer."""


class UnitState(Enum):
    """GOOD: send a request; PAUSED: refuse it at once; DUE: let it try the unit."""

    GOOD = "good"
    PAUSED = "paused"
    DUE = "due"


@dataclass(slots=True)
class Pause:
    """A pause of so many seconds, and the function that got no answer last."""

    function: int
    misses: int = 0
    length: float = 0.0
    until: float = -math.inf  # infinite while a request tries

    def end_for(self, function: int) -> float:
        return self.until + (self.length if function == self.function else 0.0)


class SilentUnits:
    """Units and functions that are paused, for `first_pause` seconds at first."""

    def __init__(self, first_pause: float) -> None:
        self._first_pause = first_pause
        # Of a whole unit, whose function is None here, or of one function of a unit.
        self._pauses: dict[tuple[int, int | None], Pause] = {}
        # Units, and functions of them, whose last request was answered: none of these is paused.
        self._answered_functions: set[tuple[int, int]] = set()

    def is_paused(self, unit: int) -> bool:
        """Return True if requests to the whole unit wait for the end of a pause."""
        return (unit, None) in self._pauses

    def state(self, unit: int, function: int, now: float) -> UnitState:
        if (unit, function) in self._answered_functions:
            return UnitState.GOOD
        pause = self._pause(unit, function)
        if pause is None:
            return UnitState.GOOD
        return UnitState.PAUSED if now < pause.end_for(function) else UnitState.DUE

    def start_trial(self, unit: int, function: int) -> int:
        """Let a request try what is due, while others are refused; return the misses so far."""
        pause = self._pause(unit, function)
        assert pause is not None
        pause.until = math.inf
        return pause.misses

    def cancel_trial(self, unit: int, function: int, now: float) -> None:
        """Let the next request try, because the last one was not sent."""
        pause = self._pause(unit, function)
        if pause is not None and pause.until == math.inf:
            pause.until = now - pause.length

    def note_answer(self, unit: int, function: int) -> bool:
        """Note an answer; return True if the unit or the function was silent before."""
        if (unit, function) in self._answered_functions:
            return False
        self._answered_functions.add((unit, function))
        if not self.is_paused(unit):
            return self._pauses.pop((unit, function), None) is not None
        # What was silent together with the unit may answer again together with it.
        self._pauses = {key: pause for key, pause in self._pauses.items() if key[0] != unit}
        return True

    def note_silence(self, unit: int, function: int, now: float) -> bool:
        """Note that no answer came in time; return True if this starts its first pause."""
        self._answered_functions.discard((unit, function))
        is_whole = all(other != unit for other, _ in self._answered_functions)
        pause = self._pauses.setdefault((unit, None if is_whole else function), Pause(function))
        if now < pause.end_for(pause.function) < math.inf:
            return False  # it was sent before the pause began
        pause.misses += 1
        pause.length = pause_after(pause.misses, self._first_pause, LONGEST_PAUSE_S)
        pause.until, pause.function = now + pause.length, function
        return pause.misses == 1

    def _pause(self, unit: int, function: int) -> Pause | None:
        return self._pauses.get((unit, None)) or self._pauses.get((unit, function))
