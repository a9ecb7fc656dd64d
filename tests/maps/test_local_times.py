"""
Points whose devices show the local time of a zone; the times themselves stand in
tests/protocol/test_times.py.
"""

from datetime import UTC, datetime
from typing import Any, get_args
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py import Point
from libmodbus_py.maps.meaning import DecodedValue
from libmodbus_py.protocol.words import TimeType
from tests.support.golden import Refused

TYPES = get_args(TimeType)

BERLIN = "Europe/Berlin"


def clock(type: str = "date48", zone: str = BERLIN, **keys: Any) -> Point:
    return Point("clock", "holding_registers", 0, type=type, time_zone=zone, **keys)


def wall(*fields: int) -> list[int]:
    """Return the registers of date48: a byte each for year, month, day, hour, minute, second."""
    year, *others = fields
    data = [year - 2000, *others]
    return [high << 8 | low for high, low in zip(data[::2], data[1::2], strict=True)]


def test_a_time_that_clocks_leave_out_is_no_value() -> None:
    point = clock()
    assert point.judge(wall(2024, 3, 31, 2, 30, 0)) == DecodedValue(None, "bad", "InvalidTime")
    plain = Point("clock", "holding_registers", 0, type="date48")
    assert plain.decode(wall(2024, 3, 31, 2, 30, 0)) == datetime(2024, 3, 31, 2, 30, tzinfo=UTC)


MOMENTS = st.datetimes(datetime(2000, 1, 3), datetime(2090, 1, 1), timezones=st.just(UTC))


@given(
    time=MOMENTS,
    type=st.sampled_from(TYPES),
    zone=st.sampled_from([BERLIN, "UTC", "Pacific/Chatham", "America/St_Johns", "Asia/Tokyo"]),
)
def test_times_in_any_zone_decode_to_what_was_encoded(time: datetime, type: str, zone: str) -> None:
    time = time.replace(microsecond=0)
    point = clock(type, zone)
    result = point.decode(point.encode(time))
    # Only a time that its zone has twice comes back as the other one: the first.
    local = time.astimezone(ZoneInfo(zone))
    is_second = local.fold == 1 and type != "iec870"
    first = local.replace(fold=0).astimezone(UTC)
    assert result == (first if is_second else time)


def test_a_missing_value_is_one_of_the_registers() -> None:
    point = clock("unix32", missing=0)
    assert point.judge([0, 0]) == DecodedValue(None, "bad", "Missing")
    # A device that counts the seconds of its local time.
    assert point.decode([0, 7200]) == datetime(1970, 1, 1, 1, tzinfo=UTC)


def test_points_of_several_times_decode_to_what_was_encoded() -> None:
    point = clock(count=2)
    moments = [datetime(2024, 1, 1, hour, tzinfo=UTC) for hour in (0, 1)]
    assert point.decode(point.encode(moments)) == moments
    assert point.encode(moments) == [*wall(2024, 1, 1, 1, 0, 0), *wall(2024, 1, 1, 2, 0, 0)]


CLOCK = {"table": "holding_registers", "type": "date48", "time_zone": BERLIN}


def test_a_wrong_zone_is_named(refused: Refused) -> None:
    refused("wrong_zones.txt", lambda keys: Point("clock", address=0, **CLOCK | keys))


def test_years_at_both_ends_are_no_crash() -> None:
    point = Point("c", "holding_registers", 0, type="date96", time_zone="Asia/Tokyo")
    assert point.judge([1, 1, 1, 0, 0, 0]).reason == "InvalidTime"
    with pytest.raises(ValueError, match=r"^c: value must be a year in 1\.\.9999"):
        point.encode(datetime(9999, 12, 31, 23, tzinfo=UTC))
    with pytest.raises(ValueError, match="with a time zone"):
        point.encode(datetime(2024, 1, 1))


def test_points_are_equal_by_their_zones() -> None:
    assert clock() == clock()
    assert clock() != clock(zone="UTC")
