"""Readings, the choice of those that are reported, and those that wait for an output."""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import AsyncIterator, Mapping, Sequence
from itertools import groupby, islice
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

from ...maps.meaning import NoValue
from ...protocol.checks import integer
from ...protocol.errors import NO_UNIT, ExceptionResponse, FrameError, InvalidResponse, ModbusError

NO_LABELS: Mapping[str, str] = MappingProxyType({})

Quality = Literal["good", "bad", "down", "offline"]


class Reading(NamedTuple):
    """
    A value of a device, or the reason why it could not be read.

    Attributes:
        time: when the poll was completed, in seconds since the epoch.
        device: the name of the device.
        name: the name of the point in the map of the device.
        value: the scaled value; None unless the quality is "good".
        units: the units of the value, such as "V".
        quality: "good"; "bad" if the device refused the request or the value is invalid; "down"
            if the device did not answer; "offline" if the point is not polled any more, because it
            was removed, or because a worker lost its lease.
        reason: the name of the error, such as "IllegalDataAddress" or "ModbusTimeoutError", or
            why there is no value, such as "Missing" (`NoValue.reason`) or "Infinite"; "Fell" of a
            good value that is a total, and smaller than before; of a list with a value, why its
            first item that is None has none; else empty if the quality is
            "good" or "offline".
        id: the number of the reading in the journal of the fleet, by which consumers drop
            repeats: each reading has a greater one than all before it; 0 without a journal.
        labels: the labels that the device had when it was polled.
    """

    time: float
    device: str
    name: str
    value: Any
    units: str
    quality: Quality
    reason: str = ""
    id: int = 0
    labels: Mapping[str, str] = NO_LABELS

    @property
    def poll(self) -> tuple[str, float]:
        """The device and the time, which all readings of a poll share."""
        return self.device, self.time


# Errors after which the device is not down, because it sent something.
ANSWERS = (ExceptionResponse, FrameError, InvalidResponse, NoValue)


def is_down(error: BaseException) -> bool:
    """Return True if an error means that the device did not answer."""
    return isinstance(error, NO_UNIT) or (
        isinstance(error, ModbusError) and not isinstance(error, ANSWERS)
    )


def reason_of(error: Exception) -> str:
    """Return the reason of a reading in place of whose value there is an error; users know it."""
    return error.reason if isinstance(error, NoValue) else type(error).__name__


def classification(value: Any) -> tuple[Any, Quality, str]:
    """Return value, quality and reason of a reading, for a value or the error in its place."""
    if isinstance(value, float):
        return (value, "good", "") if math.isfinite(value) else (None, "bad", _lack(value))
    if isinstance(value, Exception):
        return None, "down" if is_down(value) else "bad", reason_of(value)
    if isinstance(value, list) and (lacks := [*filter(None, map(_lack, value))]):
        if len(lacks) == len(value):
            return None, "bad", lacks[0]
        return [None if _lack(item) else item for item in value], "good", lacks[0]
    return value, "good", ""


def _lack(item: Any) -> str:
    """Return why an item of a list is not a value; empty if it is one."""
    if item is None:
        return "Missing"
    if isinstance(item, float) and not math.isfinite(item):
        return "Missing" if math.isnan(item) else "Infinite"
    return ""


class Changes:
    """
    Picks the values of one device that are reported: an error when it begins, the first good value
    after it, and others that differ from the last one by more than the band of the point; without
    a band, all. What was not reported for the time of its point in `again`, in seconds, is reported
    also if it is the same.
    """

    def __init__(
        self, on_change: bool, bands: Sequence[float | None], again: Sequence[float] | None = None
    ) -> None:
        self._bands = [0.0 if band is None and on_change else band for band in bands]
        self._is_filtering = any(band is not None for band in self._bands)
        # The good value that was reported last of each point, and the reason of its error since:
        # None before anything was reported.
        self._last: list[Any] = [None] * len(bands)
        self._reasons: list[str | None] = [None] * len(bands)
        self._again = again
        self._times = [0.0] * len(bands)
        self._has_errors = True

    def forget(self, at: int) -> None:
        """Report a value next time, also if it has not changed."""
        self._reasons[at] = None

    def pick(
        self, values: Sequence[Any], due: Sequence[int] | None = None, now: float = 0.0
    ) -> Sequence[int]:
        """Return the indexes of values to report, of those that were due; None for all."""
        indexes = range(len(values)) if due is None else due
        has_errors = any(issubclass(kind, Exception) for kind in set(map(type, values)))
        if not (has_errors or self._has_errors or self._is_filtering):
            return indexes
        positions = [at for at in indexes if self._is_reported(at, values[at], now)]
        self._has_errors = has_errors or any(self._reasons)
        return positions

    def _is_reported(self, at: int, value: Any, now: float) -> bool:
        reason = reason_of(value) if isinstance(value, Exception) else ""
        before, self._reasons[at] = self._reasons[at], reason
        band = self._bands[at]
        is_same = reason == before and (
            reason or (band is not None and not _differs(self._last[at], value, band))
        )
        if is_same and (self._again is None or now - self._times[at] < self._again[at]):
            return False
        self._times[at] = now
        if not reason:
            self._last[at] = value
        return True


def _differs(last: Any, value: Any, band: float) -> bool:
    if isinstance(value, list) and isinstance(last, list):
        pairs = zip(last, value, strict=False)
        return len(last) != len(value) or any(_differs(*pair, band) for pair in pairs)
    if _is_finite(last) and _is_finite(value):
        return bool(abs(value - last) > band)
    is_nan: bool = value != value and last != last
    return bool(value != last) and not is_nan


def _is_finite(value: Any) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and math.isfinite(value)


MOST_KEPT = 100_000
"""Readings that wait unless an output is told otherwise: about 15 MB."""


class Buffer(AsyncIterator[Reading]):
    """
    A queue of up to `most` readings for one consumer, which may iterate over it. The oldest are
    dropped beyond; `dropped` counts these, and readings that can never be written.

    A place in a journal (`JournalPlace`) is a buffer that fetches readings from the journal.
    """

    def __init__(self, most: int = MOST_KEPT) -> None:
        self._most = integer("buffer", most, 1, 10_000_000)
        self._kept: deque[Reading] = deque()
        self._filled = asyncio.Event()
        self._is_closed = False
        self.dropped: int = 0

    def __len__(self) -> int:
        return len(self._kept)

    async def __anext__(self) -> Reading:
        if readings := await self.take_readings(1):
            return readings[0]
        raise StopAsyncIteration

    def put_readings(self, readings: Sequence[Reading]) -> None:
        """Add readings; they are ignored after `close_buffer`."""
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

    def drop_readings(self, readings: Sequence[Reading]) -> None:
        """Count readings that were taken, and can never be written."""
        self.dropped += len(readings)

    async def confirm_readings(self, readings: Sequence[Reading]) -> None:
        """Do nothing: readings that were taken are not kept."""

    def close_buffer(self) -> None:
        """Accept no more readings; those that wait can still be taken."""
        self._is_closed = True
        self._filled.set()

    def give_up(self) -> None:
        """Close the buffer and drop the readings that are left."""
        self.close_buffer()
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

    async def take_readings(self, most: int, timeout: float | None = None) -> list[Reading]:
        """Wait for readings; return up to `most`, none after the time or when closed."""
        while not self._kept and not await self._fetch(most) and not self._is_at_end:
            try:
                async with asyncio.timeout(timeout):
                    await self._filled.wait()
            except TimeoutError:
                break
        return [self._kept.popleft() for _ in range(min(most, len(self._kept)))]

    async def take_polls(self, most: int, timeout: float | None = None) -> list[Reading]:
        """As `take_readings`, with all readings of the last poll, even if these are more."""
        readings = await self.take_readings(most, timeout)
        while readings and self._kept and self._kept[0].poll == readings[-1].poll:
            readings.append(self._kept.popleft())
        return readings

    async def polls(self, most: int) -> list[list[Reading]]:
        """Return the readings of the first polls, which stay in the buffer."""
        while True:
            groups = groupby(self._kept, lambda reading: reading.poll)
            polls = [list(group) for _, group in islice(groups, most)]
            if len(polls) == most or not await self._fetch(most):
                return polls

    async def _fetch(self, most: int) -> bool:
        """Add about so many readings; return False if there are no others now."""
        self._filled.clear()
        return False
