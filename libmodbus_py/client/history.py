"""
The history of each line, for the life of the process, whichever client asks.

A unit that owes an answer sends it to the next client of its line. So the clients of one line share
its history, those that follow each other and those that ask at the same time in different threads,
as a converter allows. Nothing here needs a lock: each change is a single one, and two threads that
make the same change set a time or a mark that either of them may set. A forked child has a copy.
"""

from __future__ import annotations

import math
import weakref
from os.path import realpath
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..ports.endpoint import Endpoint
    from .call import Call

__all__ = ["History", "Pair", "forget_lines", "history_of"]

# An answer is unusual if it takes less than this share of the time of the fastest one before, or
# more than this multiple of the time of the slowest one. HOLD and silence last as long, too.
SHARE_OF_FASTEST, TIMES_SLOWEST = 0.75, 2

# Of the time of the slowest answer, this share is kept with each further answer.
FADING = 0.95

# The most lines that are remembered, and the most requests of a unit and a function.
REMEMBERED = 1024


class Pair:
    """The states of a unit and a function; times are those of time.monotonic()."""

    is_doubted: bool = False
    silence: float = 0.0  # in DOUBT, how many seconds it must be silent
    # True if the last request was answered, but the time for HOLD was too short.
    is_answered: bool = False
    is_repeating: bool = False  # True if a frame of the pair came without a request
    slowest: float = 0.0  # how long the slowest answer of the pair ever took
    _owed: weakref.ref[Call] | None = None

    def __init__(self, now: float, interval: float = math.inf) -> None:
        # After so many seconds an answer is checked again: doubled each time.
        self.interval: float = interval
        self.heard_at: float = now  # when a frame of the unit came last
        self.checked_at: float = now
        # Length of answers -> the longest time that one took, which fades, and the shortest one.
        self._times: dict[int, tuple[float, float]] = {}
        # Request without its values -> the last answer; kept if answers repeat.
        self._answers: dict[bytes, bytes] = {}

    @property
    def quiet_at(self) -> float:
        """In DOUBT, the time at which the unit has been silent for long enough."""
        return self.heard_at + self.silence

    @property
    def owed(self) -> Call | None:
        """The request whose answer may still come; None if answers to others may come, too."""
        return None if self._owed is None else self._owed()

    def doubt(self, now: float, silence: float, owed: Call | None = None) -> None:
        """Begin to doubt, or doubt more."""
        is_single = owed is not None and (not self.is_doubted or owed is self.owed)
        self._owed = weakref.ref(owed) if owed is not None and is_single else None
        self.is_doubted = True
        self.silence = silence
        self.interval = 0.0
        self.heard(now)

    def heard(self, now: float) -> None:
        """Restart the silence."""
        self.is_answered = False
        self.heard_at = now

    def check(self, now: float, took: float = 0.0) -> None:
        """Note that no other answer follows the last one, `took` seconds after its request."""
        self.is_doubted = self.is_answered = False
        self.checked_at = now
        self.interval = max(2 * self.interval, took)

    def is_due(self, now: float, longest: float) -> bool:
        """Return True if the next answer is to be checked."""
        return now > self.checked_at + min(longest, self.interval)

    def note_answer(self, request: bytes, answer: bytes) -> None:
        """Remember the answer to a request, if answers are repeated."""
        if self.is_repeating:
            if len(self._answers) >= REMEMBERED:
                self._answers.clear()
            self._answers[_asked(request)] = answer

    def is_of_another(self, request: bytes, answer: bytes) -> bool:
        """Return True if an answer equals the last one to another request, but not to this one."""
        answers = self._answers
        return answers.get(_asked(request)) != answer and answer in list(answers.values())

    def note_time(self, size: int, took: float, *, is_sure: bool) -> None:
        """Remember how many seconds an answer took; it was not faster if it `is_sure`."""
        slowest, fastest = self._times.get(size, (0.0, math.inf))
        fastest = min(took, fastest) if is_sure else fastest
        self._times[size] = max(took, FADING * slowest), fastest
        self.slowest = max(took, self.slowest)

    def hold_of(self, size: int, took: float) -> float:
        """Return how many seconds an answer is held that took so long."""
        return TIMES_SLOWEST * max(took, self._times.get(size, (self.slowest, 0.0))[0])

    def is_too_fast(self, size: int, took: float) -> bool:
        """Return True if an answer took less time than those before let expect."""
        times = [self._times[size]] if size in self._times else self._times.values()
        fastest = min((fastest for _, fastest in times), default=0.0)
        return fastest < math.inf and took < SHARE_OF_FASTEST * fastest


class History:
    """
    The history of one line.

    Attributes:
        units: of each unit the states of its functions.
    """

    def __init__(self) -> None:
        self.units: dict[int, dict[int, Pair]] = {}

    def pair(self, unit: int, function: int, now: float, *, is_unknown: bool = False) -> Pair:
        """Return the states of a unit and a function; if `is_unknown`, its first answer is held."""
        pair = self.units.get(unit, {}).get(function)
        if pair is None:
            pair = Pair(now, 0.0 if is_unknown else math.inf)
            pair = self.units.setdefault(unit, {}).setdefault(function, pair)
        return pair

    def pairs_of(self, unit: int) -> list[tuple[int, Pair]]:
        """Return the functions of a unit, and the states of each."""
        return list(self.units.get(unit, {}).items())

    def slowest_of(self, unit: int) -> float:
        """Return how long the slowest answer of a unit took, ever; 0.0 before the first."""
        return max((pair.slowest for _, pair in self.pairs_of(unit)), default=0.0)


def _asked(request: bytes) -> bytes:
    """Return a request without the values of a write, on which the answer does not depend."""
    return request[:5]


_histories: dict[tuple[str, str], History] = {}

forget_lines = _histories.clear
"""Forget all lines, as a new process does."""


def history_of(endpoint: Endpoint) -> History:
    """Return the history of the line at an endpoint; its framing and settings do not matter."""
    kind, address = endpoint.key
    key = kind, realpath(address) if endpoint.has_path else address
    history = _histories.setdefault(key, History())
    for oldest in list(_histories)[:-REMEMBERED]:
        _histories.pop(oldest, None)
    return history
