"""
What was read before, for as long as it is fresh enough. No socket, no clock.
"""

from __future__ import annotations

from collections import Counter, OrderedDict

__all__ = ["Cache"]

MOST = 4096


class Cache:
    """
    Answers to reads, by unit and request.

    What was asked before a write of its unit is never kept: it may be older than that.
    """

    def __init__(self) -> None:
        self._answers: OrderedDict[tuple[int, bytes], tuple[float, bytes]] = OrderedDict()
        # Unit -> how many writes there were.
        self._writes: Counter[int] = Counter()

    def get(self, unit: int, request: bytes, age: float, now: float) -> bytes | None:
        """Give an answer that is at most `age` seconds old."""
        found = self._answers.get((unit, request))
        return found[1] if found is not None and now - found[0] <= age else None

    def state(self, unit: int) -> int:
        """Give what `keep` wants of the time when a request is asked."""
        return self._writes[unit]

    def keep(self, unit: int, request: bytes, answer: bytes, asked: float, state: int) -> None:
        """
        Args:
            asked: when it was asked: the answer is no older than that.
            state: as `state` gave it then.
        """
        if state != self._writes[unit]:
            return
        key = unit, request
        self._answers.pop(key, None)
        self._answers[key] = asked, answer
        if len(self._answers) > MOST:
            self._answers.popitem(last=False)

    def forget(self, unit: int) -> None:
        """Something is written there, or may be; on unit 0 to all."""
        self._writes[unit] += 1
        if unit == 0:
            self._writes.update(range(1, 256))
            self._answers.clear()
        for key in [key for key in self._answers if key[0] == unit]:
            del self._answers[key]
