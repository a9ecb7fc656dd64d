"""
Times of devices whose clocks show local time.

The registers hold the wall clock of a time zone; values are in UTC.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta, tzinfo
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from .mistakes import Path, WrongType, WrongValue
from .times import checked_time
from .values import ValueType

__all__ = ["checked_time_zone", "in_time_zone"]

HOUR = timedelta(hours=1)


def checked_time_zone(name: str | Path, given: object) -> tzinfo:
    """
    Return a time zone of the IANA database, such as "Europe/Berlin".

    Raises:
        TypeError, ValueError: this system knows no such zone.
    """
    if not isinstance(given, str):
        raise WrongType(name, f"must be the name of a time zone, not {type(given).__name__}")
    try:
        return ZoneInfo(given)
    except (ValueError, OSError, ZoneInfoNotFoundError):  # the last one is a KeyError
        wanted = "a time zone that this system knows, such as Europe/Berlin"
        raise WrongValue(name, f"must be {wanted}, not {given[:100]!r}") from None


def in_time_zone(kind: ValueType, zone: tzinfo) -> ValueType:
    """
    Return a type of times whose registers hold the local time of a zone.

    A local time that occurs twice, when summer time ends, is the first of both, unless the type
    tells summer time from standard time, as iec870 does; one that is left out, when summer time
    begins, is not a value.
    """
    has_summer = kind.name == "iec870"

    def pack(name: str | Path, value: object) -> bytes:
        try:
            local = checked_time(name, value).astimezone(zone)
        except OverflowError:
            raise WrongValue(name, "must be a year in 1..9999") from None
        data = kind.pack(name, local.replace(tzinfo=UTC, fold=0))
        return _with_summer(data) if has_summer and local.dst() else data

    def unpack(data: bytes) -> datetime:
        wall = kind.unpack(data)
        if not has_summer:
            return _moment(wall, zone, fold=0)
        is_summer = bool(data[4] & 0x80)
        return _moment(wall + HOUR * is_summer, zone, fold=not is_summer)

    return replace(kind, pack=pack, unpack=unpack)


def _with_summer(data: bytes) -> bytes:
    """Set the bit SU of a CP56Time2a, which says that the hour is of summer time."""
    return data[:4] + bytes([data[4] | 0x80]) + data[5:]


def _moment(wall: datetime, zone: tzinfo, *, fold: int) -> datetime:
    """
    Return the moment in UTC at which the clocks of a zone show a time.

    Raises:
        ValueError: they never do.
    """
    local = wall.replace(tzinfo=zone, fold=fold)
    try:
        moment = local.astimezone(UTC)
        shown = moment.astimezone(zone)
    except OverflowError:
        raise ValueError(f"{wall:%Y-%m-%d} is out of range") from None
    if shown.replace(tzinfo=None) != wall.replace(tzinfo=None):
        raise ValueError(f"clocks in {zone} never show {wall:%Y-%m-%d %H:%M:%S}")
    return moment
