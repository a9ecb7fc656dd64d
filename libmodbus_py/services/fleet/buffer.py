"""
Readings that wait for an output or an iteration.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Sequence
from itertools import groupby, islice

from ...protocol.checks import integer
from .readings import Reading

__all__ = ["MOST_KEPT", "Buffer"]

MOST_KEPT = 100_000
"""Readings that wait unless an output is told otherwise: about 15 MB."""


class Buffer:
    """
    A queue of readings for one consumer. Adding readings never blocks.

    A place in a journal (`JournalPlace`) is a buffer that fetches readings from the journal.

    Args:
        most: the most readings that wait, 1..10000000; the oldest are dropped beyond.

    Attributes:
        dropped: number of readings that were lost, or can never be written.

    Raises:
        TypeError, ValueError: `most` has the wrong type or range.
    """

    def __init__(self, most: int = MOST_KEPT) -> None:
        self._most = integer("buffer", most, 1, 10_000_000)
        self._kept: deque[Reading] = deque()
        self._filled = asyncio.Event()
        self._is_closed = False
        self.dropped: int = 0

    def __len__(self) -> int:
        return len(self._kept)

    def put(self, readings: Sequence[Reading]) -> None:
        """Add readings; they are ignored after `close`."""
        if self._is_closed:
            return
        self._kept.extend(readings)
        while len(self._kept) > self._most:
            self._kept.popleft()
            self.dropped += 1
        self._filled.set()

    def put_back(self, readings: Sequence[Reading]) -> None:
        """Return readings that could not be written; the oldest are dropped if there is no room."""
        room = self._most - len(self._kept)
        self.dropped += max(0, len(readings) - room)
        self._kept.extendleft(reversed(readings[-room:] if room else ()))
        if self._kept:
            self._filled.set()

    def drop(self, readings: Sequence[Reading]) -> None:
        """Count readings that were taken, and can never be written."""
        self.dropped += len(readings)

    async def confirm(self, readings: Sequence[Reading]) -> None:
        """Do nothing: readings that were taken are not kept."""

    def close(self) -> None:
        """Accept no more readings; those that wait can still be taken."""
        self._is_closed = True
        self._filled.set()

    def give_up(self) -> None:
        """Close the buffer and drop the readings that are left."""
        self.close()
        self.dropped += len(self._kept)
        self._kept.clear()

    @property
    def is_over(self) -> bool:
        """True if there are no readings, and will be none."""
        return self._is_at_end and not self._kept

    @property
    def _is_at_end(self) -> bool:
        """True if no readings will be added."""
        return self._is_closed

    async def take(self, most: int, timeout: float | None = None) -> list[Reading]:
        """Wait for readings; return up to `most`, none after the time or when closed."""
        while not self._kept and not await self._fetch(most) and not self._is_at_end:
            try:
                async with asyncio.timeout(timeout):
                    await self._filled.wait()
            except TimeoutError:
                break
        return [self._kept.popleft() for _ in range(min(most, len(self._kept)))]

    async def take_polls(self, most: int, timeout: float | None = None) -> list[Reading]:
        """As `take`, but the readings of the last poll are complete, even if these are more."""
        taken = await self.take(most, timeout)
        while taken and self._kept and self._kept[0].poll == taken[-1].poll:
            taken.append(self._kept.popleft())
        return taken

    async def polls(self, most: int) -> list[list[Reading]]:
        """Return the readings of the first polls, which stay in the buffer."""
        while len(found := self._first_polls(most)) < most and await self._fetch(most):
            pass
        return found

    def _first_polls(self, most: int) -> list[list[Reading]]:
        groups = groupby(self._kept, lambda each: each.poll)
        return [list(group) for _, group in islice(groups, most)]

    async def _fetch(self, most: int) -> bool:
        """Add about so many readings; return False if there are no others now."""
        self._filled.clear()
        return False
