"""
Readings that wait for an output; the oldest are dropped if there are too many.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Sequence
from itertools import groupby, islice
from typing import Protocol

from ...protocol.checks import integer
from .readings import Reading

__all__ = ["MOST_KEPT", "Buffer", "WaitingReadings"]

MOST_KEPT = 100_000


class WaitingReadings(Protocol):
    """
    The readings that wait for an output: a `Buffer`, or a place in a journal.

    Attributes:
        dropped: number of readings that were lost, or can never be written.
    """

    dropped: int

    def __len__(self) -> int:
        """Return the number of readings that wait."""
        ...

    @property
    def is_over(self) -> bool:
        """True if there are no readings, and will be none."""
        ...

    async def take_polls(self, most: int, timeout: float | None = None) -> list[Reading]:
        """Wait for readings, and return whole polls, with about so many; none after the time."""
        ...

    async def polls(self, most: int) -> list[list[Reading]]:
        """Return the readings of the first polls, which are not taken."""
        ...

    def put_back(self, readings: Sequence[Reading]) -> None:
        """Return readings that were taken, and could not be written."""
        ...

    def drop(self, readings: Sequence[Reading]) -> None:
        """Count readings that were taken, and can never be written."""
        ...

    async def confirm(self, readings: Sequence[Reading]) -> None:
        """Note that readings that were taken were written."""
        ...

    def close(self) -> None:
        """Expect no more readings; those that wait can still be taken."""
        ...

    def give_up(self) -> None:
        """Close; nothing is taken any more."""
        ...


class Buffer:
    """
    A queue of readings for one consumer. Adding readings never blocks.

    Args:
        most: the most readings that wait, 1..10000000; the oldest are dropped beyond.

    Attributes:
        dropped: number of dropped readings.

    Raises:
        TypeError, ValueError: `most` has the wrong type or range.
    """

    def __init__(self, most: int = MOST_KEPT) -> None:
        self._most = integer("buffer", most, 1, 10_000_000)
        self._kept: deque[Reading] = deque(maxlen=most)
        self._filled = asyncio.Event()
        self._is_closed = False
        self.dropped: int = 0

    def __len__(self) -> int:
        return len(self._kept)

    def put(self, readings: Sequence[Reading]) -> None:
        """Add readings; they are ignored after `close`."""
        if self._is_closed:
            return
        self.dropped += max(0, len(self._kept) + len(readings) - self._most)
        self._kept.extend(readings)
        self._filled.set()

    def put_back(self, readings: Sequence[Reading]) -> None:
        """Return readings that could not be written; the oldest are dropped if there is no room."""
        room = self._most - len(self._kept)
        self.dropped += max(0, len(readings) - room)
        self._kept.extendleft(reversed(readings[-room:] if room else ()))
        if self._kept:
            self._filled.set()

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
        """True if the buffer is closed and empty."""
        return self._is_closed and not self._kept

    async def take(self, most: int, timeout: float | None = None) -> list[Reading]:
        """Wait for readings; return up to `most`, none after the time or when closed."""
        if not self._kept and not self._is_closed:
            self._filled.clear()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(timeout):
                    await self._filled.wait()
        return [self._kept.popleft() for _ in range(min(most, len(self._kept)))]

    async def take_polls(self, most: int, timeout: float | None = None) -> list[Reading]:
        """As `take`, but the readings of the last poll are complete, even if these are more."""
        taken = await self.take(most, timeout)
        while taken and self._kept and self._kept[0].poll == taken[-1].poll:
            taken.append(self._kept.popleft())
        return taken

    async def polls(self, most: int) -> list[list[Reading]]:
        """Return the readings of the first polls, which stay in the buffer."""
        groups = groupby(self._kept, lambda each: each.poll)
        return [list(group) for _, group in islice(groups, most)]

    def drop(self, readings: Sequence[Reading]) -> None:
        """Count readings that were taken, and can never be written."""
        self.dropped += len(readings)

    async def confirm(self, readings: Sequence[Reading]) -> None:
        """Do nothing: what was taken is not kept."""
