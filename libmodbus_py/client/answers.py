"""
The earlier answers on a line without ids, and their times, with which others are compared (`Line`).
"""

from __future__ import annotations

import math
from collections import Counter

__all__ = ["Answers"]

# The most requests, and kinds of answers, that are remembered.
REMEMBERED = 1024

# The last different answers to each request that are remembered.
DIFFERENT = 3

# Of the time of the slowest answer, this share is kept with each further answer.
FADING = 0.95

# An answer is unusual if it takes less than this share of the time of the fastest one before, or
# more than this multiple of the time of the slowest one.
SHARE_OF_FASTEST, TIMES_SLOWEST = 0.75, 2

NO_TIMES = 0.0, math.inf

# Functions whose answer is the same for all requests that begin with the same five bytes.
SAME_ANSWER = frozenset([0x0F, 0x10, 0x17])


class Answers:
    """The last good answers to each request, the latest of all, and the slowest ones."""

    def __init__(self) -> None:
        # Unit and request -> its last different answers, the latest first: one wrong answer must
        # not hide the right one. Unit and answer -> how many requests have it.
        self._last: dict[tuple[int, bytes], tuple[bytes, ...]] = {}
        self._having: Counter[tuple[int, bytes]] = Counter()
        self._latest: tuple[int, bytes, bytes] | None = None  # the latest of all
        # Unit, function and length -> the longest time that such an answer took, which fades, and
        # the shortest one.
        self._times: dict[tuple[int, int, int], tuple[float, float]] = {}
        self._slowest_of: dict[int, float] = {}  # unit -> the longest time of all

    def is_to_latest(self, unit: int, request: bytes) -> bool:
        """Return True if the latest answer was one to the same request."""
        return self._latest is not None and self._latest[:2] == (unit, _asked(request))

    def is_latest(self, unit: int, request: bytes, answer: bytes) -> bool:
        """Return True if the latest answer was the same one, to the same request."""
        return self._latest == (unit, _asked(request), answer)

    def is_of_another(self, unit: int, request: bytes, answer: bytes) -> bool:
        """Return True if an answer is one of the last to another request, not the last to this."""
        own = self._last.get((unit, _asked(request)), ())
        return own[:1] != (answer,) and self._having[unit, answer] > (answer in own)

    def add(self, unit: int, request: bytes, answer: bytes) -> None:
        """Remember the answer to a request."""
        asked = _asked(request)
        self._latest = unit, asked, answer
        if len(self._last) >= REMEMBERED:
            self._last.clear()
            self._having.clear()
        own = self._last.get((unit, asked), ())
        if own[:1] == (answer,):
            return
        kept = (answer, *(each for each in own if each != answer))[:DIFFERENT]
        self._last[unit, asked] = kept
        if answer not in own:
            self._having[unit, answer] += 1
        if (oldest := own[-1:]) and oldest[0] not in kept:
            self._having[unit, oldest[0]] -= 1
            if not self._having[unit, oldest[0]]:
                del self._having[unit, oldest[0]]

    def note_time(self, unit: int, answer: bytes, took: float, *, was_held: bool = False) -> None:
        """Remember how many seconds an answer took; if it was held, it may have been another's."""
        if len(self._times) >= REMEMBERED:
            self._times.clear()
        kind = unit, answer[0], len(answer)
        slowest, fastest = self._times.get(kind, NO_TIMES)
        self._times[kind] = max(took, FADING * slowest), fastest if was_held else min(took, fastest)
        self._slowest_of[unit] = max(took, self._slowest_of.get(unit, 0.0))

    def slowest_like(self, unit: int, answer: bytes) -> float:
        """Return how long the slowest answer of the same unit, function and length took."""
        return self._times.get((unit, answer[0], len(answer)), NO_TIMES)[0]

    def is_usual(self, unit: int, answer: bytes, took: float) -> bool:
        """Return False if an answer took less time, or more, than those before let expect."""
        fastest = min(self._times.get((unit, answer[0], len(answer)), NO_TIMES))
        slowest = self.slowest_of(unit) or math.inf
        return SHARE_OF_FASTEST * fastest <= took <= TIMES_SLOWEST * slowest

    def slowest_of(self, unit: int) -> float:
        """Return how long the slowest answer of a unit took, ever; 0.0 before the first."""
        return self._slowest_of.get(unit, 0.0)


def _asked(request: bytes) -> bytes:
    """Return what the answer to a request depends on."""
    return request[:5] if request[0] in SAME_ANSWER else request
