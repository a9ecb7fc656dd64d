"""
Times of devices whose clocks show local time, by the rules of Berlin: summer time from 2026-03-29
01:00 UTC to 2026-10-25 01:00 UTC.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import pytest

from libmodbus_py.protocol.times import checked_time_zone, in_time_zone
from libmodbus_py.protocol.values import value_type
from tests.support.cases import each_case

BERLIN = checked_time_zone("time_zone", "Europe/Berlin")
UNIX = in_time_zone(value_type("unix32"), BERLIN)
IEC870 = in_time_zone(value_type("iec870"), BERLIN)


def utc(*fields: int) -> datetime:
    return datetime(*fields, tzinfo=UTC)  # type: ignore[arg-type, misc]


@each_case(
    ("moment", "wall"),
    [
        (utc(2026, 1, 1, 11), utc(2026, 1, 1, 12)),
        (utc(2026, 7, 1, 10), utc(2026, 7, 1, 12)),
        (utc(2026, 3, 29, 0, 59, 59), utc(2026, 3, 29, 1, 59, 59)),
        (utc(2026, 3, 29, 1), utc(2026, 3, 29, 3)),
        # This hour occurs twice, and the first one is meant.
        (utc(2026, 10, 25, 0, 30), utc(2026, 10, 25, 2, 30)),
        (utc(2026, 10, 25, 2), utc(2026, 10, 25, 3)),
    ],
)
def test_registers_hold_what_the_clock_on_the_wall_shows(moment: datetime, wall: datetime) -> None:
    registers = UNIX.encode(moment)
    assert registers == value_type("unix32").encode(wall)
    assert UNIX.decode(registers) == moment


def test_an_hour_that_is_left_out_is_no_value() -> None:
    registers = value_type("unix32").encode(utc(2026, 3, 29, 2, 30))
    with pytest.raises(ValueError, match="clocks in Europe/Berlin never show 2026-03-29 02:30:00"):
        UNIX.decode(registers)


@each_case("hour", range(24))
def test_a_type_that_tells_summer_time_has_each_hour_once(hour: int) -> None:
    """CP56Time2a (IEC 60870-5-4): the highest bit of the hours says that it is summer time."""
    for day, is_summer in ((24, True), (25, hour < 1), (26, False)):
        moment = utc(2026, 10, day, hour, 30)
        registers = IEC870.encode(moment)
        data = b"".join(each.to_bytes(2, "big") for each in registers)
        assert bool(data[4] & 0x80) is is_summer
        assert IEC870.decode(registers) == moment


@each_case(
    ("given", "error", "text"),
    [
        (1, TypeError, "time_zone must be the name of a time zone, not int"),
        ("Europe/Nowhere", ValueError, "time_zone must be a time zone .*, not 'Europe/Nowhere'"),
        ("../etc/passwd", ValueError, "time_zone must be a time zone that this system knows"),
        ("", ValueError, "time_zone must be a time zone that this system knows"),
    ],
)
def test_what_is_no_time_zone_is_refused(given: Any, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        checked_time_zone("time_zone", given)


def test_a_time_beyond_the_calendar_is_refused() -> None:
    east = checked_time_zone("time_zone", "Asia/Tokyo")
    with pytest.raises(ValueError, match=r"must be a year in 1\.\.9999"):
        in_time_zone(value_type("unix64"), east).encode(utc(9999, 12, 31, 23))
