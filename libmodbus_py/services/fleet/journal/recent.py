"""
The newest polls of a journal, in memory: the file takes those that it lacks from here, and outputs
that keep up never wait for the disk.
"""

from __future__ import annotations

from collections import OrderedDict

from .polls import JournalPoll

__all__ = ["RecentPolls"]

# Readings that are kept for outputs that keep up: about 7 MB.
MOST_IN_MEMORY = 50_000

# Readings that wait for a disk, which may take none for seconds: about 75 MB.
MOST_WAITING = 500_000


class RecentPolls:
    """
    The newest polls of a run. Their ids follow each other without a gap.

    Args:
        last: the id before that of the first reading.

    Attributes:
        last: the last id that was added.
        taken: the last id that was taken for the file, or dropped before it could be.
        dropped: number of readings that were dropped before they were taken for the file.
    """

    def __init__(self, last: int) -> None:
        # The id of the first reading -> the poll.
        self._polls: OrderedDict[int, JournalPoll] = OrderedDict()
        self._size = 0
        self.last: int = last
        self.taken: int = last
        self.dropped: int = 0

    @property
    def before(self) -> int:
        """The last id that is not in memory, nor behind it."""
        return next(iter(self._polls), self.last + 1) - 1

    def add(self, poll: JournalPoll) -> None:
        """Add a poll, whose first id follows the last one."""
        self._polls[poll.first] = poll
        self._size += len(poll.readings)
        self.last = poll.last
        while self._size > MOST_IN_MEMORY and len(self._polls) > 1 and self._may_drop():
            _, oldest = self._polls.popitem(last=False)
            self._size -= len(oldest.readings)
            if oldest.last > self.taken:
                self.taken = oldest.last
                self.dropped += len(oldest.readings)

    def _may_drop(self) -> bool:
        """Return True if the file has the oldest poll, or too many wait for it."""
        return self.before < self.taken or self._size > MOST_WAITING

    def after(self, number: int, most: int) -> list[JournalPoll] | None:
        """
        Return the polls behind an id, at least one if there is one, and at most so many readings.

        Returns:
            None if the next poll is not in memory any more.
        """
        found: list[JournalPoll] = []
        count = 0
        if number < self.before:
            return None
        while (poll := self._polls.get(number + 1)) is not None:
            count += len(poll.readings)
            if found and count > most:
                break
            found.append(poll)
            number = poll.last
        return found

    def take(self, most: int) -> list[JournalPoll]:
        """Return polls for the file, with about so many readings, which were not taken before."""
        taken = self.after(self.taken, most) or []
        if taken:
            self.taken = taken[-1].last
        return taken
