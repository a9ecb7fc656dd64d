"""Times in registers, by the published layouts, and back."""

from datetime import UTC, datetime, timedelta, timezone
from typing import Any, get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py.protocol.times import checked_time_zone, in_time_zone
from libmodbus_py.protocol.values import TimeType, value_type
from tests.support.cases import each_case

NOON = datetime(2026, 7, 1, 12, 30, 15, tzinfo=UTC)

# Seconds since 1970 as `date -u +%s` prints them; CP56Time2a as IEC 60870-5-4 lays it out, in
# Schneider's registers: year; month, day of the week and day; hour and minute; milliseconds.
TIMES = [
    ("unix32", [0, 0], datetime(1970, 1, 1, tzinfo=UTC)),
    ("unix32", [0x6A45, 0x0857], NOON),
    ("unix32", [0xFFFF, 0xFFFF], datetime(2106, 2, 7, 6, 28, 15, tzinfo=UTC)),
    ("unix64", [0xFFFF, 0xFFFF, 0xFFFF, 0xFFFF], datetime(1969, 12, 31, 23, 59, 59, tzinfo=UTC)),
    ("ms64", [0, 0, 0, 1500], datetime(1970, 1, 1, 0, 0, 1, 500_000, tzinfo=UTC)),
    ("iec870", [26, 7 << 8 | 3 << 5 | 1, 12 << 8 | 30, 15_000], NOON),
    ("iec870", [26, 12 << 8 | 4 << 5 | 31, 23 << 8 | 59, 59_999],
     datetime(2026, 12, 31, 23, 59, 59, 999_000, tzinfo=UTC)),
    ("iec870", [99, 12 << 8 | 4 << 5 | 31, 23 << 8 | 59, 59_000],
     datetime(2099, 12, 31, 23, 59, 59, tzinfo=UTC)),
    ("date48", [0x1A07, 0x010C, 0x1E0F], NOON),
    ("date48", [0xFF07, 0x010C, 0x1E0F], NOON.replace(year=2255)),
    ("bcddate48", [0x2607, 0x0112, 0x3015], NOON),
    ("bcddate48", [0x9907, 0x0112, 0x3015], NOON.replace(year=2099)),
    ("date96", [2026, 7, 1, 12, 30, 15], NOON),
]  # fmt: skip


@each_case(("name", "cells", "time"), TIMES)
def test_times_are_encoded_and_decoded_in_utc(name: str, cells: list[int], time: datetime) -> None:
    kind = value_type(name)
    assert kind.decode(cells) == time
    assert kind.decode(cells).utcoffset() == timedelta(0)
    assert kind.encode(time) == cells
    assert kind.encode(time.astimezone(timezone(timedelta(hours=-5)))) == cells


def test_summer_time_is_an_hour_ahead_of_utc() -> None:
    cells = [26, 7 << 8 | 3 << 5 | 1, 0x8000 | 13 << 8 | 30, 15_000]
    assert value_type("iec870").decode(cells) == NOON


# Registers that are no time: a bit says so, or a field is out of range.
NONE = [
    ("iec870", [26, 7 << 8 | 1, 12 << 8 | 0x80 | 30, 0]),
    ("iec870", [0, 0, 0, 0]),
    ("iec870", [0xFFFF] * 4),
    ("iec870", [26, 7 << 8 | 1, 12 << 8 | 30, 60_000]),
    ("iec870", [100, 7 << 8 | 1, 12 << 8 | 30, 0]),
    ("iec870", [26, 2 << 8 | 30, 12 << 8 | 30, 0]),
    ("date48", [0x1A0D, 0x010C, 0x1E0F]),
    ("date48", [0xFFFF] * 3),
    ("bcddate48", [0x260A, 0x0112, 0x3015]),
    ("bcddate48", [0x2607, 0x0B12, 0x3015]),
    ("bcddate48", [0x2613, 0x0112, 0x3015]),
    ("date96", [0, 0, 0, 0, 0, 0]),
    ("ms64", [0x7FFF, 0xFFFF, 0xFFFF, 0xFFFF]),
]


@each_case(("name", "cells"), NONE)
def test_registers_that_are_no_time_are_refused(name: str, cells: list[int]) -> None:
    with pytest.raises(ValueError, match=f"hold no {name}: .* is not a time"):
        value_type(name).decode(cells)


WRONG = [
    ("unix32", 5, "value must be a datetime, not int"),
    ("unix32", datetime(2026, 7, 1), "value must be a datetime with a time zone, not 2026"),
    ("unix32", datetime(1969, 7, 1, tzinfo=UTC), "value cannot be 1969-07-01T00:00:00"),
    ("iec870", datetime(2100, 7, 1, tzinfo=UTC), "value must be a year in 2000..2099, not 2100"),
    ("bcddate48", datetime(2100, 7, 1, tzinfo=UTC), "value must be a year in 2000..2099, not 2100"),
    ("date48", datetime(1999, 7, 1, tzinfo=UTC), "value must be a year in 2000..2255, not 1999"),
    ("ms64", datetime(1, 1, 1, tzinfo=timezone(timedelta(hours=9))), "value must be a year in 1"),
]


@each_case(("name", "value", "message"), WRONG)
def test_times_outside_the_range_of_a_type_are_refused(name: str, value: Any, message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        value_type(name).encode(value)


STEPS = {"ms64": 1000, "iec870": 1000}


@given(
    st.sampled_from(get_args(TimeType)),
    st.datetimes(datetime(2000, 1, 1), datetime(2099, 12, 31), timezones=st.just(UTC)),
    st.sampled_from(["ABCD", "CDAB", "BADC", "DCBA"]),
)
def test_times_decode_to_what_was_encoded(name: str, time: datetime, order: str) -> None:
    step = STEPS.get(name, 1_000_000)
    time_ = time.replace(microsecond=time.microsecond // step * step)
    kind = value_type(name, order=order)
    assert kind.decode(kind.encode(time)) == time_


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
        # This hour occurs twice, and the first time is meant.
        (utc(2026, 10, 25, 0, 30), utc(2026, 10, 25, 2, 30)),
        (utc(2026, 10, 25, 2), utc(2026, 10, 25, 3)),
    ],
)
def test_registers_contain_the_local_time(moment: datetime, wall: datetime) -> None:
    registers = UNIX.encode(moment)
    assert registers == value_type("unix32").encode(wall)
    assert UNIX.decode(registers) == moment
    assert UNIX.decode(registers).utcoffset() == timedelta(0)


def test_an_hour_that_is_left_out_is_no_value() -> None:
    registers = value_type("unix32").encode(utc(2026, 3, 29, 2, 30))
    with pytest.raises(ValueError, match="clocks in Europe/Berlin never show 2026-03-29 02:30:00"):
        UNIX.decode(registers)


@each_case("hour", range(24))
def test_a_type_with_a_bit_for_summer_time_has_each_hour_once(hour: int) -> None:
    """CP56Time2a (IEC 60870-5-4): the highest bit of the hours says that it is summer time."""
    for day, is_summer in ((24, True), (25, hour < 1), (26, False)):
        moment = utc(2026, 10, day, hour, 30)
        registers = IEC870.encode(moment)
        data = b"".join(register.to_bytes(2, "big") for register in registers)
        assert data[4] == (hour + 1 + is_summer) % 24 | 0x80 * is_summer
        assert IEC870.decode(registers) == moment
