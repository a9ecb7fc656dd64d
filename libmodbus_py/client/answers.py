"""
The earlier answers on a line without ids, and their times, with which others are compared (`Line`).
"""

from __future__ import annotations

from collections import Counter, deque

__all__ = ["Answers"]

# The most requests, and kinds of answers, that are remembered.
REMEMBERED = 1024

# Of the time of the slowest answer, this share is kept with each further answer.
FADING = 0.95

# Functions whose answer is the same for all requests that begin with the same five bytes.
SAME_ANSWER = frozenset([0x0F, 0x10, 0x17])


class Answers:
    """The last good answer to each request, the latest answers of all, and the slowest ones."""

    def __init__(self) -> None:
        self.slowest: float = 0.0  # seconds
        # Unit and request -> its last answer; unit and answer -> how many requests have it.
        self._last: dict[tuple[int, bytes], bytes] = {}
        self._having: Counter[tuple[int, bytes]] = Counter()
        # Answers that may come again, although there are newer ones to the same requests.
        self._recent: deque[tuple[int, bytes, bytes]] = deque(maxlen=8)
        # Unit, function and length -> the longest time that such an answer took.
        self._slowest: dict[tuple[int, int, int], float] = {}

    def is_to_latest(self, unit: int, request: bytes) -> bool:
        """Return True if the latest answer was one to the same request."""
        return bool(self._recent) and self._recent[-1][:2] == (unit, _asked(request))

    def is_latest(self, unit: int, request: bytes, answer: bytes) -> bool:
        """Return True if the latest answer was the same one, to the same request."""
        return bool(self._recent) and self._recent[-1] == (unit, _asked(request), answer)

    def is_of_another(self, unit: int, request: bytes, answer: bytes) -> bool:
        """Return True if an answer was one to another request lately, and not the last to this."""
        asked = _asked(request)
        if self._last.get((unit, asked)) == answer:
            return False
        return self._having.get((unit, answer), 0) > 0 or any(
            each == answer and other == unit and what != asked for other, what, each in self._recent
        )

    def add(self, unit: int, request: bytes, answer: bytes) -> None:
        """Remember the answer to a request."""
        asked = _asked(request)
        self._recent.append((unit, asked, answer))
        if len(self._last) >= REMEMBERED:
            self._last.clear()
            self._having.clear()
        before = self._last.get((unit, asked))
        if before != answer:
            if before is not None:
                self._having[unit, before] -= 1
                if not self._having[unit, before]:
                    del self._having[unit, before]
            self._last[unit, asked] = answer
            self._having[unit, answer] += 1

    def note_time(self, unit: int, answer: bytes, took: float) -> None:
        """Remember how many seconds an answer took."""
        if len(self._slowest) >= REMEMBERED:
            self._slowest.clear()
        kind = unit, answer[0], len(answer)
        self._slowest[kind] = max(took, FADING * self._slowest.get(kind, 0.0))
        self.slowest = max(took, FADING * self.slowest)

    def slowest_like(self, unit: int, answer: bytes) -> float | None:
        """Return how long the slowest answer of the same unit, function and length took."""
        return self._slowest.get((unit, answer[0], len(answer)))


def _asked(request: bytes) -> bytes:
    """Return what the answer to a request depends on."""
    return request[:5] if request[0] in SAME_ANSWER else request
