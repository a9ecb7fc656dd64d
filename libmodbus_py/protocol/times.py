"""
Dates and times in registers.

Values are datetimes with a time zone. Registers hold none, so that the time of a device is taken as
UTC here, and what is written is converted to UTC first; `local_times` has the other zones.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from struct import pack, unpack
from typing import Any, NamedTuple

from .mistakes import Path, WrongType, WrongValue

__all__ = ["TIMES", "checked_time", "pack_time", "unpack_time"]

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

CENTURY = 2000
"""The year from which dates in bytes count; CP56Time2a and others have no century."""


class TimeForm(NamedTuple):
    """
    One form of times in bytes, high byte first.

    Attributes:
        pack: returns the bytes of a time in UTC; raises OverflowError for one that does not fit.
        unpack: returns the time in some bytes; raises ValueError or OverflowError if it is none.
    """

    pack: Callable[[datetime], bytes]
    unpack: Callable[[bytes], datetime]


def checked_time(name: str | Path, value: object) -> datetime:
    """
    Return a datetime in UTC.

    Raises:
        TypeError: no datetime.
        ValueError: it has no time zone.
    """
    if not isinstance(value, datetime):
        raise WrongType(name, f"must be a datetime, not {type(value).__name__}")
    if value.utcoffset() is None:
        raise WrongValue(name, f"must be a datetime with a time zone, not {value.isoformat()}")
    try:
        return value.astimezone(UTC)
    except OverflowError:
        raise WrongValue(name, "must be a year in 1..9999") from None


# --- since 1970 ---------------------------------------------------------------------------


def _since_1970(bits: int, step: timedelta) -> TimeForm:
    signed = bits > 32  # 32 bits are unsigned: they last until 2106

    def to_bytes(time: datetime) -> bytes:
        return ((time - EPOCH) // step).to_bytes(bits // 8, "big", signed=signed)

    def from_bytes(data: bytes) -> datetime:
        return EPOCH + int.from_bytes(data, "big", signed=signed) * step

    return TimeForm(to_bytes, from_bytes)


# --- dates --------------------------------------------------------------------------------


def _short_year(year: int, most: int) -> int:
    if not CENTURY <= year <= CENTURY + most:
        raise OverflowError(f"must be a year in {CENTURY}..{CENTURY + most}, not {year}")
    return year - CENTURY


def _iec870_to(time: datetime) -> bytes:
    milliseconds = time.second * 1000 + time.microsecond // 1000
    day = time.month << 8 | time.isoweekday() << 5 | time.day
    hour = time.hour << 8 | time.minute
    return pack(">4H", _short_year(time.year, 99), day, hour, milliseconds)


def _iec870_from(data: bytes) -> datetime:
    """Return a CP56Time2a of IEC 60870-5-4 in Schneider's four registers."""
    year, day, hour, milliseconds = unpack(">4H", data)
    if hour & 0x80:
        raise ValueError("the device says that its time is invalid")
    if year & 0x7F > 99:
        raise ValueError("out of range")
    time = datetime(
        CENTURY + (year & 0x7F),
        day >> 8 & 15,
        day & 31,
        hour >> 8 & 31,
        hour & 63,
        milliseconds // 1000,
        milliseconds % 1000 * 1000,
        UTC,
    )
    # Summer time is an hour ahead of the standard time, which is taken as UTC.
    return time - timedelta(hours=1) if hour & 0x8000 else time


def _fields(time: datetime) -> tuple[int, ...]:
    return time.month, time.day, time.hour, time.minute, time.second


def _bytes_to(time: datetime) -> bytes:
    return bytes((_short_year(time.year, 255), *_fields(time)))


def _bytes_from(data: bytes) -> datetime:
    year, *others = data
    return datetime(CENTURY + year, *others, tzinfo=UTC)  # type: ignore[arg-type, misc]


def _digits_to(time: datetime) -> bytes:
    return bytes.fromhex(
        "".join(f"{each:02}" for each in (_short_year(time.year, 99), *_fields(time)))
    )


def _digits_from(data: bytes) -> datetime:
    text = data.hex()
    return _bytes_from(bytes(int(text[at : at + 2]) for at in range(0, 12, 2)))


def _registers_to(time: datetime) -> bytes:
    return pack(">6H", time.year, *_fields(time))


def _registers_from(data: bytes) -> datetime:
    return datetime(*unpack(">6H", data), tzinfo=UTC)  # type: ignore[misc]


TIMES: dict[str, TimeForm] = {
    "unix32": _since_1970(32, timedelta(seconds=1)),
    "unix64": _since_1970(64, timedelta(seconds=1)),
    "ms64": _since_1970(64, timedelta(milliseconds=1)),
    "iec870": TimeForm(_iec870_to, _iec870_from),
    "date48": TimeForm(_bytes_to, _bytes_from),
    "bcddate48": TimeForm(_digits_to, _digits_from),
    "date96": TimeForm(_registers_to, _registers_from),
}
"""Name -> form."""


def pack_time(form: TimeForm, name: str | Path, value: Any) -> bytes:
    """
    Return the bytes of a time.

    Raises:
        TypeError, ValueError: no datetime with a time zone, or one that the form cannot hold.
    """
    time = checked_time(name, value)
    try:
        return form.pack(time)
    except OverflowError as error:
        reason = str(error) if "year" in str(error) else f"cannot be {time.isoformat()}"
        raise WrongValue(name, f"{reason} in this type") from None


def unpack_time(form: TimeForm, data: bytes) -> datetime:
    """
    Return the time in some bytes.

    Raises:
        ValueError: they hold none.
    """
    try:
        return form.unpack(data)
    except (ValueError, OverflowError):
        raise ValueError(f"{data.hex(' ').upper()} is not a time") from None
