"""
A cache of responses to reads. No socket, no clock.
"""

from __future__ import annotations

from collections import Counter, OrderedDict

__all__ = ["Cache"]

MOST = 4096


class Cache:
    """
    Responses to reads, by unit and request.

    The response to a request that was sent before a write to the same unit is never kept, because
    it may contain older values.
    """

    def __init__(self) -> None:
        self._answers: OrderedDict[tuple[int, bytes], tuple[float, bytes]] = OrderedDict()
        # Unit -> number of writes.
        self._writes: Counter[int] = Counter()

    def get(self, unit: int, request: bytes, age: float, now: float) -> bytes | None:
        """Return a response that is at most `age` seconds old, or None."""
        found = self._answers.get((unit, request))
        return found[1] if found is not None and now - found[0] <= age else None

    def state(self, unit: int) -> int:
        """Return the state of a unit when a request is sent, for `keep`."""
        return self._writes[unit]

    def keep(self, unit: int, request: bytes, answer: bytes, asked: float, state: int) -> None:
        """
        Keep a response.

        Args:
            asked: when the request was sent; the response is no older.
            state: the result of `state` at that time.
        """
        if state != self._writes[unit]:
            return
        key = unit, request
        self._answers.pop(key, None)
        self._answers[key] = asked, answer
        if len(self._answers) > MOST:
            self._answers.popitem(last=False)

    def forget(self, unit: int) -> None:
        """Drop the responses of a unit that may be written to; those of all units for unit 0."""
        self._writes[unit] += 1
        if unit == 0:
            self._writes.update(range(1, 256))
            self._answers.clear()
        for key in [key for key in self._answers if key[0] == unit]:
            del self._answers[key]
