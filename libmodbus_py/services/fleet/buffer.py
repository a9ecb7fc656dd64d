"""
Readings that wait for an output: so many at most, then the oldest are dropped.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Sequence

from ...protocol.checks import integer
from .readings import Reading

__all__ = ["MOST_KEPT", "Buffer"]

MOST_KEPT = 100_000


class Buffer:
    """
    Takes readings at once, whoever reads them how slowly ever. One reads.

    Args:
        most: readings that wait, 1..10000000; then the oldest are dropped.

    Attributes:
        dropped: how many were.

    Raises:
        TypeError, ValueError: by name.
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
        """Take readings; none after `close`."""
        if self._is_closed:
            return
        self.dropped += max(0, len(self._kept) + len(readings) - self._most)
        self._kept.extend(readings)
        self._filled.set()

    def put_back(self, readings: Sequence[Reading]) -> None:
        """Take back what was taken from it, as far as there is room: it is the oldest."""
        room = self._most - len(self._kept)
        self.dropped += max(0, len(readings) - room)
        self._kept.extendleft(reversed(readings[-room:] if room else ()))
        if self._kept:
            self._filled.set()

    def close(self) -> None:
        """Nothing will come any more."""
        self._is_closed = True
        self._filled.set()

    def give_up(self) -> None:
        """Nobody takes what is left."""
        self.close()
        self.dropped += len(self._kept)
        self._kept.clear()

    @property
    def is_over(self) -> bool:
        """Whether there is nothing left, and nothing will come."""
        return self._is_closed and not self._kept

    async def take(self, most: int, patience: float | None = None) -> list[Reading]:
        """Wait for readings, no longer than told, and give so many of them at most."""
        if not self._kept and not self._is_closed:
            self._filled.clear()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(patience):
                    await self._filled.wait()
        return [self._kept.popleft() for _ in range(min(most, len(self._kept)))]
