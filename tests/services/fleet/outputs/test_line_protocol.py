"""
Readings in the line protocol of InfluxDB, as its specification has it.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import pytest

from libmodbus_py import Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig, Reading
from libmodbus_py.services.fleet.outputs.influx import LineProtocol
from libmodbus_py.services.fleet.readings import Quality
from tests.support.cases import each_case

TIME = 1_700_000_000.25
STAMP = "1700000000250000000"

MAP = RegisterMap(
    [
        Point("level", "holding_registers", 0),
        Point("state", "holding_registers", 1, states={0: "off", 1: "on"}),
    ]
)


def reading(
    value: Any, name: str = "level", quality: Quality = "good", reason: str = ""
) -> Reading:
    return Reading(TIME, "north", name, value, "m", quality, reason)


def protocol(measurement: str = "modbus", name: str = "north") -> LineProtocol:
    made = LineProtocol(measurement)
    made.describe({name: DeviceConfig(name, "tcp://127.0.0.1", MAP)})
    return made


def lines(*readings: Reading, **labels: str) -> str:
    return protocol().lines([each._replace(labels=labels) for each in readings]).decode()


@each_case(
    ("value", "field"),
    [
        (230.5, "level=230.5"),
        (7, "level=7"),
        (-7, "level=-7"),
        (1e-7, "level=1e-07"),
        (2**64 - 1, "level=18446744073709551615"),
        (True, "level=true"),
        (False, "level=false"),
        ("on", 'level="on"'),
        ("", 'level=""'),
        ('5" pipe\\valve', r'level="5\" pipe\\valve"'),
        ("two\nlines\x1b", r'level="two\\x0alines\\x1b"'),
        ([1, 2.5], "level.0=1,level.1=2.5"),
        ([1, None], "level.0=1"),
        ({"door": True, "mode": 3}, "level.door=true,level.mode=3"),
        (datetime(2026, 1, 2, tzinfo=UTC), 'level="2026-01-02T00:00:00+00:00"'),
    ],
)
def test_values_are_fields(value: Any, field: str) -> None:
    assert lines(reading(value)) == f"modbus,device=north {field} {STAMP}\n"


def test_a_poll_is_one_line_and_the_next_one_another() -> None:
    later = reading(3)._replace(time=TIME + 1)
    other = reading(4)._replace(device="south")
    assert lines(reading(1), reading(2, "flow"), later, other).splitlines() == [
        f"modbus,device=north level=1,flow=2 {STAMP}",
        "modbus,device=north level=3 1700000001250000000",
        f"modbus,device=south level=4 {STAMP}",
    ]


@each_case(
    ("name", "spelled"),
    [
        ("a b", r"a\ b"),
        ("a,b=c", r"a\,b\=c"),
        ('a"b', 'a"b'),
        ("a\\", "a%5C"),
        ("time", "time_"),
        ("_field", "_field_"),
        ("Füllstand", "Füllstand"),
    ],
)
def test_names_are_escaped(name: str, spelled: str) -> None:
    assert lines(reading(1, name)) == f"modbus,device=north {spelled}=1 {STAMP}\n"


def test_labels_are_tags_in_order_without_empty_ones() -> None:
    labels = {"site": "Halle 2", "line": "a,b=c\\", "area": ""}
    assert lines(reading(1), **labels) == (
        rf"modbus,device=north,line=a\,b\=c%5C,site=Halle\ 2 level=1 {STAMP}" + "\n"
    )


def test_measurements_are_escaped() -> None:
    assert protocol("my, data").lines([reading(1)]).startswith(rb"my\,\ data,device")


@each_case("measurement", ["", "_internal", "#comment", "two\nlines", "back\\slash", "x" * 201])
def test_bad_measurements_are_refused(measurement: str) -> None:
    with pytest.raises(ValueError, match="measurement"):
        LineProtocol(measurement)


@each_case(
    ("quality", "reason", "fields"),
    [
        ("bad", "Missing", 'level.quality="bad",level.reason="Missing"'),
        ("down", "ModbusTimeoutError", 'level.quality="down",level.reason="ModbusTimeoutError"'),
        ("offline", "", 'level.quality="offline"'),
    ],
)
def test_a_point_without_a_value_tells_why(quality: Quality, reason: str, fields: str) -> None:
    told = lines(reading(None, quality=quality, reason=reason))
    assert told == f"modbus,device=north {fields} {STAMP}\n"


def test_a_value_may_have_a_reason() -> None:
    assert lines(reading(5, reason="Fell")) == (
        f'modbus,device=north level=5,level.reason="Fell" {STAMP}\n'
    )


def test_a_point_with_states_is_always_text() -> None:
    """InfluxDB refuses a number in a field that was text before."""
    assert "state=" in lines(reading("on", "state"))
    assert lines(reading(7, "state")) == f'modbus,device=north state="7" {STAMP}\n'


def test_a_point_without_anything_to_tell_is_left_out() -> None:
    assert lines(reading([])) == ""
    assert lines(reading([]), reading(1, "flow")) == f"modbus,device=north flow=1 {STAMP}\n"
