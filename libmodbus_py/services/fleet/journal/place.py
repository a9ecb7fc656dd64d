"""
The readings of a journal that wait for one output.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import deque
from collections.abc import Sequence
from itertools import groupby, islice
from typing import Protocol

from ....protocol.logs import HarmlessLogger
from ..readings import Reading
from .polls import JournalPoll

__all__ = ["LONGEST_EPISODE", "JournalPlace", "Supply"]

logger: HarmlessLogger = HarmlessLogger(__name__)

# The most polls that `polls` returns.
MOST_POLLS = 100

LONGEST_EPISODE = 600.0
"""Seconds without a dropped reading after which the next one is reported again."""

# Seconds after which an output that confirmed readings goes on, though the disk has not noted it.
LONGEST_NOTING = 1.0


class Supply(Protocol):
    """
    The part of a journal that a place uses.

    Attributes:
        last: the last id that was given to a reading.
    """

    last: int

    async def after(self, number: int, most: int) -> tuple[list[JournalPoll], int]:
        """Return polls behind an id, and the id up to which there are no others."""
        ...

    def between(self, after: int, last: int) -> int:
        """Return the number of readings that have ids above `after`, up to `last`."""
        ...

    def note(self) -> asyncio.Future[None]:
        """Begin to write the places; return a future that ends when they are, or cannot be."""
        ...


class JournalPlace:
    """
    The readings of a journal behind the last one that an output has confirmed.

    To a pump it is what a `Buffer` is; but what was taken and not confirmed is not lost when the
    program ends.

    Args:
        name: of the output.
        supply: the journal.
        confirmed: the id of the last confirmed reading.

    Attributes:
        name: as given.
        confirmed: the id of the last reading that the output has confirmed; it never falls.
        dropped: number of readings that were deleted before the output confirmed them, or can
            never be written.
    """

    def __init__(self, name: str, supply: Supply, confirmed: int) -> None:
        self.name: str = name
        self.confirmed: int = confirmed
        self.dropped: int = 0
        self._supply = supply
        self._read = confirmed
        self._waiting: deque[Reading] = deque()
        self._filled = asyncio.Event()
        self._is_closed = False
        self._told_until = -math.inf

    def __len__(self) -> int:
        return self._supply.between(self.confirmed, self._supply.last)

    def wake(self) -> None:
        """Note that the journal has more readings."""
        self._filled.set()

    def deleted(self, last: int) -> None:
        """Count the readings that were deleted from the journal before they were confirmed."""
        if last <= self.confirmed:
            return
        self.dropped += self._supply.between(self.confirmed, last)
        self.confirmed = last
        self._read = max(self._read, last)
        while self._waiting and self._waiting[0].id <= last:
            self._waiting.popleft()
        now = asyncio.get_running_loop().time()
        if now > self._told_until:
            logger.error(
                "%s: the journal is full; its oldest readings are dropped unconfirmed", self.name
            )
        self._told_until = now + LONGEST_EPISODE

    # --- as a buffer ------------------------------------------------------------------------

    async def take(self, most: int, timeout: float | None = None) -> list[Reading]:
        """Wait for readings; return whole polls, none after the time or when closed."""
        if not self._waiting:
            await self._fill(most, timeout)
        taken: list[Reading] = []
        while self._waiting and (len(taken) < most or self._waiting[0].poll == taken[-1].poll):
            taken.append(self._waiting.popleft())
        return taken

    take_polls = take

    async def _fill(self, most: int, timeout: float | None) -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout):
                while not await self._read_more(most) and not self._is_at_end:
                    await self._filled.wait()

    async def _read_more(self, most: int) -> bool:
        """Take readings from the journal; return False if there are no more now."""
        self._filled.clear()
        before = self._read
        polls, end = await self._supply.after(before, most)
        for each in polls:
            if each.first > self._read:  # else these were deleted while they were read
                self._skip_to(each.first - 1)
                self._waiting.extend(each.readings)
                self._read = each.last
        self._skip_to(end)
        return self._read > before

    def _skip_to(self, number: int) -> None:
        """Count the readings up to an id, which the journal lacks."""
        if number > self._read:
            self.dropped += self._supply.between(self._read, number)
            if self.confirmed == self._read:
                self.confirmed = number
            self._read = number

    @property
    def _is_at_end(self) -> bool:
        return self._is_closed and self._read >= self._supply.last

    async def polls(self, most: int) -> list[list[Reading]]:
        """Return the readings of the first polls, which are not taken."""
        most = min(most, MOST_POLLS)
        while len(found := self._first(most)) < most and await self._read_more(most):
            pass
        return found

    def _first(self, most: int) -> list[list[Reading]]:
        groups = groupby(self._waiting, lambda each: each.poll)
        return [list(group) for _, group in islice(groups, most)]

    def put_back(self, readings: Sequence[Reading]) -> None:
        """Return readings that could not be written."""
        self._waiting.extendleft(each for each in reversed(readings) if each.id > self.confirmed)

    def drop(self, readings: Sequence[Reading]) -> None:
        """Count readings that were taken, and can never be written."""
        if readings and readings[-1].id > self.confirmed:
            self.dropped += len(readings)
            self.confirmed = readings[-1].id
            self._supply.note()

    async def confirm(self, readings: Sequence[Reading]) -> None:
        """Note that the output has accepted readings; return when the disk has noted it."""
        if not readings or readings[-1].id <= self.confirmed:
            return
        self.confirmed = readings[-1].id
        await asyncio.wait([self._supply.note()], timeout=LONGEST_NOTING)

    def close(self) -> None:
        """Wait for no more readings; those that wait can still be taken."""
        self._is_closed = True
        self._filled.set()

    def give_up(self) -> None:
        """Close the place; what waits is for the next run."""
        self.close()
        self._waiting.clear()

    @property
    def is_over(self) -> bool:
        """True if the place is closed, and all readings were taken."""
        return self._is_at_end and not self._waiting
