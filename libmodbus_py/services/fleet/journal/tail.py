"""
The newest readings of a journal, in memory: outputs that keep up never wait for the disk.
"""

from __future__ import annotations

from bisect import bisect_right
from operator import attrgetter

from .polls import JournalPoll

__all__ = ["Tail"]

_first = attrgetter("first")

# Polls that were dropped and are still in the list, before the list is shortened.
MOST_STALE = 1000


class Tail:
    """
    The newest polls, up to so many readings.

    Args:
        most: the most readings that are kept; the oldest are dropped beyond.
        before: the id before that of the first reading.

    Attributes:
        before: the last id that is not in here, nor behind it.
        last: the last id that was added.
    """

    def __init__(self, most: int, before: int) -> None:
        self._most = most
        self._polls: list[JournalPoll] = []
        self._stale = 0
        self._size = 0
        self.before: int = before
        self.last: int = before

    def add(self, poll: JournalPoll) -> None:
        """Add a poll, whose ids are greater than all before."""
        self._polls.append(poll)
        self.last = poll.last
        self._size += len(poll.readings)
        while self._size > self._most and self._stale < len(self._polls) - 1:
            oldest = self._polls[self._stale]
            self._polls[self._stale] = JournalPoll(oldest.first, oldest.last, ())
            self._stale += 1
            self._size -= len(oldest.readings)
            self.before = oldest.last
        if self._stale > MOST_STALE:
            del self._polls[: self._stale]
            self._stale = 0

    def after(self, number: int, most: int) -> list[JournalPoll] | None:
        """
        Return the polls behind an id, at least one if there is one, and at most so many readings.

        Returns:
            None if the next poll may have been dropped.
        """
        if number < self.before:
            return None
        at = bisect_right(self._polls, number, lo=self._stale, key=_first)
        found: list[JournalPoll] = []
        count = 0
        for poll in self._polls[at : at + most]:
            count += len(poll.readings)
            if found and count > most:
                break
            found.append(poll)
        return found
