"""
The readings of a journal that wait: the newest ones in memory, for the file, which takes those that
it lacks from here, and for outputs that keep up; and those that one output has not confirmed.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Sequence
from typing import Protocol

from ....protocol.logs import HarmlessLogger
from ..readings import Buffer, Reading
from .schema import JournalPoll

logger: HarmlessLogger = HarmlessLogger(__name__)

NOTING_S = 1.0
"""Seconds after which an output that confirmed readings goes on although the disk is slow."""


class _Journal(Protocol):
    """The part of `Journal`, which imports this file, that a place uses."""

    @property
    def last(self) -> int: ...

    async def after(self, number: int, most: int) -> tuple[list[JournalPoll], int]: ...

    def note_places(self) -> asyncio.Future[None]: ...


class JournalPlace(Buffer):
    """
    The readings of a journal behind the last one that an output has `confirmed`, an id that never
    falls; what was taken and not confirmed is taken again in the next run.
    """

    def __init__(self, name: str, journal: _Journal, confirmed_id: int, waiting: int) -> None:
        super().__init__()
        self.name: str = name
        self.confirmed: int = confirmed_id
        self._journal = journal
        self._waiting = waiting
        # The id of the last reading that was fetched.
        self._fetched = confirmed_id
        self._was_full = False

    def __len__(self) -> int:
        return self._waiting

    def wake(self, count: int = 0) -> None:
        """Look for new readings: the journal has so many more, or can read others now."""
        self._waiting += count
        self._filled.set()

    def put_back(self, readings: Sequence[Reading]) -> None:
        """Return readings that could not be written, unless they were deleted meanwhile."""
        self._kept.extendleft(row for row in reversed(readings) if row.id > self.confirmed)

    def drop_readings(self, readings: Sequence[Reading]) -> None:
        """Count readings that were taken, and can never be written."""
        if (count := self._pass(readings)) > 0:
            self.dropped += count
            self._journal.note_places()

    async def confirm_readings(self, readings: Sequence[Reading]) -> None:
        """Store that the output has accepted readings; return when this is in the file."""
        if self._pass(readings) > 0:
            await asyncio.wait([self._journal.note_places()], timeout=NOTING_S)

    def _pass(self, readings: Sequence[Reading]) -> int:
        """Move behind readings, and return the number of those that were not passed before."""
        ids = [reading.id for reading in readings if reading.id > self.confirmed]
        self.confirmed = max(ids, default=self.confirmed)
        self._waiting -= len(ids)
        return len(ids)

    def give_up(self) -> None:
        """Close the place; the readings that wait are for the next run."""
        self.close_buffer()
        self._kept.clear()

    def note_deletions(self, polls: Sequence[tuple[int, int]]) -> None:
        """Count polls, by first id and number of readings, that were deleted unconfirmed."""
        gaps = [(first, count) for first, count in polls if first > self.confirmed]
        if not gaps:
            return
        self._lose(sum(count for _, count in gaps))
        self.confirmed = sum(gaps[-1]) - 1
        self._fetched = max(self._fetched, self.confirmed)
        while self._kept and self._kept[0].id <= self.confirmed:
            self._kept.popleft()
        if not self._was_full:
            self._was_full = True
            logger.error(
                "%s: the journal is full; its oldest readings are dropped unconfirmed", self.name
            )

    def _lose(self, count: int) -> None:
        self.dropped += count
        self._waiting -= count

    @property
    def _is_at_end(self) -> bool:
        return self._is_closed and self._fetched >= self._journal.last

    async def _fetch(self, most: int) -> bool:
        self._filled.clear()
        before = self._fetched
        polls, end = await self._journal.after(before, most)
        for poll in polls:
            if poll.first > self._fetched:  # else these were deleted while they were read
                self._kept.extend(poll.readings)
                self._fetched = poll.last
        self._fetched = max(self._fetched, end)
        if self._fetched >= self._journal.last:  # what waits and is not here cannot be read
            self._lose(self._waiting - len(self._kept))
        return self._fetched > before


# Readings that are kept for outputs that keep up: about 7 MB.
MOST_IN_MEMORY = 50_000

# Readings that wait for a disk, which may take none for seconds: about 75 MB.
MOST_WAITING = 500_000


class RecentPolls:
    """The newest polls of a run, whose ids follow each other without a gap."""

    def __init__(self, last: int) -> None:
        # The id of the first reading -> the poll.
        self._polls: OrderedDict[int, JournalPoll] = OrderedDict()
        self._size = 0
        self.last: int = last
        # The last id that was taken for the file, or dropped before it could be.
        self.taken: int = last
        self.dropped: int = 0

    @property
    def before(self) -> int:
        """The id before the first one in memory."""
        return next(iter(self._polls), self.last + 1) - 1

    def add(self, poll: JournalPoll) -> None:
        """Add a poll, whose first id follows the last one."""
        self._polls[poll.first] = poll
        self._size += len(poll.readings)
        self.last = poll.last
        while self._size > MOST_IN_MEMORY and len(self._polls) > 1:
            if self.before >= self.taken and self._size <= MOST_WAITING:
                return  # the file lacks the oldest poll, and there is room
            _, oldest = self._polls.popitem(last=False)
            self._size -= len(oldest.readings)
            if oldest.last > self.taken:
                self.taken = oldest.last
                self.dropped += len(oldest.readings)

    def after(self, number: int, most: int) -> list[JournalPoll] | None:
        """Return about so many readings after an id; None if the next one is not in memory."""
        polls: list[JournalPoll] = []
        count = 0
        if number < self.before:
            return None
        while (poll := self._polls.get(number + 1)) is not None:
            count += len(poll.readings)
            if polls and count > most:
                break
            polls.append(poll)
            number = poll.last
        return polls

    def take_unwritten(self, most: int) -> list[JournalPoll]:
        polls = self.after(self.taken, most) or []
        if polls:
            self.taken = polls[-1].last
        return polls
