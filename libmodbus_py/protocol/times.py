"""
Dates and times in registers.

Values are datetimes with a time zone. Registers hold none, so that the time of a device is taken as
UTC, and what is written is converted to UTC first. `in_time_zone` is for devices whose registers
hold the wall clock of a zone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta, tzinfo
from struct import pack, unpack
from typing import Any, NamedTuple

from .checks import instance
from .mistakes import Path, WrongValue
from .value_types import ValueType

CENTURY = 2000
"""The year from which dates in bytes count; CP56Time2a and others have no century."""


class TimeForm(NamedTuple):
    """A time in UTC as bytes, high byte first, and back; an OverflowError if it does not fit."""

    pack: Callable[[datetime], bytes]
    unpack: Callable[[bytes], datetime]


def _checked_time(name: str | Path, value: object) -> datetime:
    time: datetime = instance(name, value, datetime, "a datetime")
    if time.utcoffset() is None:
        raise WrongValue(name, f"must be a datetime with a time zone, not {time.isoformat()}")
    try:
        return time.astimezone(UTC)
    except OverflowError:
        raise WrongValue(name, "must be a year in 1..9999") from None


def _since(year: int, bits: int, step: timedelta) -> TimeForm:
    epoch = datetime(year, 1, 1, tzinfo=UTC)
    signed = bits > 32  # 32 bits are unsigned: those since 1970 last until 2106

    def to_bytes(time: datetime) -> bytes:
        return ((time - epoch) // step).to_bytes(bits // 8, "big", signed=signed)

    def from_bytes(data: bytes) -> datetime:
        return epoch + int.from_bytes(data, "big", signed=signed) * step

    return TimeForm(to_bytes, from_bytes)


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
    second, rest = divmod(milliseconds, 1000)
    date = CENTURY + (year & 0x7F), day >> 8 & 15, day & 31
    time = datetime(*date, hour >> 8 & 31, hour & 63, second, rest * 1000, UTC)
    # Summer time is an hour ahead of the standard time, which is taken as UTC.
    return time - timedelta(hours=1) if hour & 0x8000 else time


def _fields(time: datetime) -> tuple[int, ...]:
    return time.timetuple()[1:6]


def _bytes_from(data: bytes) -> datetime:
    year, *others = data
    return datetime(CENTURY + year, *others, tzinfo=UTC)  # type: ignore[arg-type, misc]


def _digits_to(time: datetime) -> bytes:
    numbers = (_short_year(time.year, 99), *_fields(time))
    return bytes.fromhex("".join(f"{number:02}" for number in numbers))


def _digits_from(data: bytes) -> datetime:
    text = data.hex()
    return _bytes_from(bytes(int(text[at : at + 2]) for at in range(0, 12, 2)))


def _weekday_to(time: datetime) -> bytes:
    """Return year; month and day of the week, 1 for Monday; day and hour; minute and second."""
    month, *others = _fields(time)
    return pack(">H6B", _short_year(time.year, 99), month, time.isoweekday(), *others)


def _weekday_from(data: bytes) -> datetime:
    year, month, _, *others = unpack(">H6B", data)
    return _bytes_from(bytes((year, month, *others)))


TIMES: dict[str, TimeForm] = {
    "unix32": _since(1970, 32, timedelta(seconds=1)),
    "unix64": _since(1970, 64, timedelta(seconds=1)),
    "ms64": _since(1970, 64, timedelta(milliseconds=1)),
    "y2k32": _since(CENTURY, 32, timedelta(seconds=1)),
    "iec870": TimeForm(_iec870_to, _iec870_from),
    "date48": TimeForm(
        lambda time: bytes((_short_year(time.year, 255), *_fields(time))), _bytes_from
    ),
    "bcddate48": TimeForm(_digits_to, _digits_from),
    "date64": TimeForm(_weekday_to, _weekday_from),
    "shortdate96": TimeForm(
        lambda time: pack(">6H", _short_year(time.year, 99), *_fields(time)),
        lambda data: _bytes_from(bytes(unpack(">6H", data))),
    ),
    "date96": TimeForm(
        lambda time: pack(">6H", time.year, *_fields(time)),
        lambda data: datetime(*unpack(">6H", data), tzinfo=UTC),  # type: ignore[misc]
    ),
}
"""Name -> form."""


def pack_time(form: TimeForm, name: str | Path, value: Any) -> bytes:
    """Return the bytes of a datetime with a time zone."""
    time = _checked_time(name, value)
    try:
        return form.pack(time)
    except OverflowError as error:
        reason = str(error) if "year" in str(error) else f"cannot be {time.isoformat()}"
        raise WrongValue(name, f"{reason} in this type") from None


def unpack_time(form: TimeForm, data: bytes) -> datetime:
    """Return the time in some bytes; raise a ValueError if they contain none."""
    try:
        return form.unpack(data)
    except (ValueError, OverflowError):
        raise ValueError(f"{data.hex(' ').upper()} is not a time") from None


# --- local times --------------------------------------------------------------------------


def checked_time_zone(name: str | Path, zone: Any) -> tzinfo:
    """Return a time zone of the IANA database, such as "Europe/Berlin"."""
    from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

    try:
        return ZoneInfo(instance(name, zone, str, "the name of a time zone"))
    except (ValueError, OSError, ZoneInfoNotFoundError):  # the last one is a KeyError
        form = "a time zone that this system knows, such as Europe/Berlin"
        raise WrongValue(name, f"must be {form}, not {zone[:100]!r}") from None


def in_time_zone(kind: ValueType, zone: tzinfo) -> ValueType:
    """
    Return a type of times whose registers hold the local time of a zone.

    A local time that occurs twice, when summer time ends, is the first of both, unless the type
    tells summer time, as iec870 does; one that is left out when it begins is not a value.
    """
    has_summer = kind.name == "iec870"

    def pack(name: str | Path, value: object) -> bytes:
        try:
            local = _checked_time(name, value).astimezone(zone)
        except OverflowError:
            raise WrongValue(name, "must be a year in 1..9999") from None
        data = kind.pack(name, local.replace(tzinfo=UTC, fold=0))
        if has_summer and local.dst():
            return data[:4] + bytes([data[4] | 0x80]) + data[5:]  # SU of CP56Time2a
        return data

    def unpack(data: bytes) -> datetime:
        wall = kind.unpack(data)
        if not has_summer:
            return _moment(wall, zone, fold=0)
        is_summer = bool(data[4] & 0x80)
        return _moment(wall + timedelta(hours=is_summer), zone, fold=not is_summer)

    return replace(kind, pack=pack, unpack=unpack)


def _moment(wall: datetime, zone: tzinfo, *, fold: int) -> datetime:
    """Return the moment in UTC at which the clocks of a zone show a time."""
    local = wall.replace(tzinfo=zone, fold=fold)
    try:
        moment = local.astimezone(UTC)
        clock = moment.astimezone(zone)
    except OverflowError:
        raise ValueError(f"{wall:%Y-%m-%d} is out of range") from None
    if clock.replace(tzinfo=None) != wall.replace(tzinfo=None):
        raise ValueError(f"clocks in {zone} never show {wall:%Y-%m-%d %H:%M:%S}")
    return moment
