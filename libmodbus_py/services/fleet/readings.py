"""
Readings, and the choice of those that are reported.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

from ...maps.meaning import NoValue
from ...protocol.errors import (
    NO_UNIT,
    ExceptionResponse,
    FrameError,
    InvalidResponse,
    ModbusError,
)

__all__ = ["NO_LABELS", "Changes", "Quality", "Reading", "classified", "is_down"]

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
        unit: the unit of the value, such as "V".
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
    unit: str
    quality: Quality
    reason: str = ""
    id: int = 0
    labels: Mapping[str, str] = NO_LABELS

    @property
    def poll(self) -> tuple[str, float]:
        """The device and the time, which all readings of a poll share."""
        return self.device, self.time


# Errors after which the device is not down, because it sent something.
ANSWERS = (ExceptionResponse, FrameError, InvalidResponse)


def is_down(error: BaseException) -> bool:
    """Return True if an error means that the device did not answer."""
    return isinstance(error, NO_UNIT) or (
        isinstance(error, ModbusError) and not isinstance(error, ANSWERS)
    )


def reason_of(error: Exception) -> str:
    """
    Return the reason of a reading in place of whose value there is an error.

    Consumers of readings know the reasons by these words.
    """
    if isinstance(error, NoValue):
        return error.reason
    return "ValueError" if isinstance(error, ValueError) else type(error).__name__


def classified(value: Any) -> tuple[Any, Quality, str]:
    """
    Return value, quality and reason of a reading, for a value of a plan or the error in its place.

    A value that is not finite is none: JSON has no word for it.
    """
    if isinstance(value, Exception):
        return None, "down" if is_down(value) else "bad", reason_of(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None, "bad", _lack(value)
    if isinstance(value, list) and (lacks := [*filter(None, map(_lack, value))]):
        if len(lacks) == len(value):
            return None, "bad", lacks[0]
        return [None if _lack(each) else each for each in value], "good", lacks[0]
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
    Picks the values of one device that are reported.

    An error is reported once, when it begins; the first good value after it is reported always.

    Args:
        on_change: True to report good values only if they changed.
        bands: for each point, by how much a value must differ from the last one reported; None
            for any change with `on_change`, and for every value without.
    """

    __slots__ = ("_bands", "_has_errors", "_is_filtering", "_last", "_reasons")

    def __init__(self, on_change: bool, bands: Sequence[float | None]) -> None:
        self._bands = [0.0 if band is None and on_change else band for band in bands]
        self._is_filtering = any(band is not None for band in self._bands)
        # What was reported last of each point: a good value, and the reason of an error; None for
        # the reason before anything was reported.
        self._last: list[Any] = [None] * len(bands)
        self._reasons: list[str | None] = [None] * len(bands)
        self._has_errors = True

    def pick(self, values: Sequence[Any], due: Sequence[int] | None = None) -> Sequence[int]:
        """
        Return the indexes of the values to report; exceptions stand for missing values.

        Args:
            values: of all points.
            due: the indexes of those that were read; None for all.
        """
        indexes = range(len(values)) if due is None else due
        has_errors = any(isinstance(value, Exception) for value in values)
        if not (has_errors or self._has_errors or self._is_filtering):
            return indexes
        reported = [at for at in indexes if self._is_reported(at, values[at])]
        self._has_errors = has_errors or any(self._reasons)
        return reported

    def _is_reported(self, at: int, value: Any) -> bool:
        reason = reason_of(value) if isinstance(value, Exception) else ""
        before, self._reasons[at] = self._reasons[at], reason
        if reason:
            return reason != before
        band = self._bands[at]
        if before == "" and band is not None and not _differs(self._last[at], value, band):
            return False
        self._last[at] = value
        return True


def _differs(last: Any, value: Any, band: float) -> bool:
    if isinstance(value, list):
        pairs = zip(last, value, strict=False)
        return len(last) != len(value) or any(_differs(*pair, band) for pair in pairs)
    if not isinstance(value, int | float) or isinstance(value, bool):
        return bool(last != value)
    if math.isfinite(value) and math.isfinite(last):
        return bool(abs(value - last) > band)
    is_same: bool = value == last or (math.isnan(value) and math.isnan(last))
    return not is_same
