"""
Totals, which never fall: one that is smaller than before is believed when it is read again.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

__all__ = ["Falls", "Totals"]


class Falls(NamedTuple):
    """
    The totals of a poll that are smaller than before.

    Attributes:
        doubtful: the indexes of those that must be read again before they are believed.
        fell: the indexes of those that were read again, and are still smaller.
    """

    doubtful: frozenset[int]
    fell: frozenset[int]


class Totals:
    """
    Remembers the totals of one device from poll to poll. No clock.

    Args:
        indexes: those of the points with `never_falls`, among the values of a poll.
    """

    __slots__ = ("_doubtful", "_last")

    def __init__(self, indexes: Iterable[int]) -> None:
        self._last: dict[int, Any] = dict.fromkeys(indexes)
        self._doubtful: frozenset[int] = frozenset()

    def take(self, values: Sequence[Any]) -> Falls:
        """
        Return which totals of a poll are smaller than before.

        Args:
            values: all values of the poll; what is not a number is left out.
        """
        if not self._last:
            return NO_FALLS
        smaller = {
            at
            for at, before in self._last.items()
            if before is not None and isinstance(values[at], int | float) and values[at] < before
        }
        fell = frozenset(smaller & self._doubtful)
        doubtful = frozenset(smaller - fell)
        for at in self._last.keys() - doubtful:
            if isinstance(values[at], int | float):
                self._last[at] = values[at]
        unread = {at for at in self._doubtful if not isinstance(values[at], int | float)}
        self._doubtful = doubtful | unread
        return Falls(doubtful, fell)

    def before(self, at: int) -> Any:
        """Return the last total that was believed."""
        return self._last[at]


NO_FALLS = Falls(frozenset(), frozenset())
