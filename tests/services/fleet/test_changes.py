"""
Which values are told, what they are called, and which wait for an output.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

import pytest

from libmodbus_py import (
    FrameError,
    GatewayTargetFailedToRespond,
    IllegalDataAddress,
    InvalidResponse,
    ModbusConnectionError,
    ModbusTimeoutError,
)
from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs.forms import as_csv, as_json
from libmodbus_py.services.fleet.readings import Changes, classified, is_down

NAN = math.nan


def told(values: list[Any], *, on_change: bool = False, band: float | None = None) -> list[Any]:
    changes = Changes(on_change, [band])
    return [value for value in values if list(changes.pick([value]))]


@pytest.mark.parametrize(
    ("options", "values", "expected"),
    [
        ({}, [1, 1, 2], [1, 1, 2]),
        ({"on_change": True}, [1, 1, 2, 2, 1], [1, 2, 1]),
        ({"on_change": True}, [True, True, False], [True, False]),
        ({"on_change": True}, ["a", "a", "b"], ["a", "b"]),
        ({"on_change": True}, [[1, 2], [1, 2], [1, 3]], [[1, 2], [1, 3]]),
        ({"on_change": True}, [NAN, NAN, 1.0, NAN], [NAN, 1.0, NAN]),
        ({"on_change": True}, [math.inf, math.inf, -math.inf], [math.inf, -math.inf]),
        # The states of a point have names, but for a number that the map does not name.
        ({"on_change": True}, ["on", 7, 7, "on"], ["on", 7, "on"]),
        ({"band": 5.0}, [[1], 7, [1]], [[1], 7, [1]]),
        # From what was told last, not from the value before: a slow drift is told as well.
        ({"band": 1.0}, [10, 10.6, 11.0, 11.1, 10.5, 10.0], [10, 11.1, 10.0]),
        ({"band": 0.0}, [1, 1, 2], [1, 2]),
        ({"band": 1.0}, [[1, 5], [1.5, 5.5], [1.5, 6.5]], [[1, 5], [1.5, 6.5]]),
    ],
)
def test_what_is_told(options: Any, values: list[Any], expected: list[Any]) -> None:
    assert repr(told(values, **options)) == repr(expected)


@pytest.mark.parametrize("options", [{}, {"on_change": True}, {"band": 5.0}])
def test_what_is_not_good_is_told_when_it_begins_and_when_it_ends(options: Any) -> None:
    down, other = ModbusTimeoutError("no answer"), IllegalDataAddress()
    values = [down, down, other, other, down, 7]
    assert told(values, **options) == [down, other, down, 7]
    assert told([7, down, 7], **options) == [7, down, 7]


def test_points_are_told_for_themselves() -> None:
    changes = Changes(False, [1.0, None])
    assert list(changes.pick([10, 5])) == [0, 1]
    assert list(changes.pick([10.5, 5])) == [1]
    assert list(changes.pick([12, 5])) == [0, 1]


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (ModbusTimeoutError("no answer"), True),
        (ModbusConnectionError("lost"), True),
        (GatewayTargetFailedToRespond(), True),
        (IllegalDataAddress(), False),
        (FrameError("noise"), False),
        (InvalidResponse("unit 3 answered"), False),
        (ValueError("no bcd16"), False),
    ],
)
def test_down_is_who_gives_no_answer(error: Exception, expected: bool) -> None:
    assert is_down(error) is expected


def test_readings_as_text() -> None:
    readings = [
        Reading(0.0, "a,b", "voltage", 230.5, "V", "good"),
        Reading(0.0, "ä", "flags", [True, False], "", "good"),
        Reading(0.0, "c", "rest", None, "", "down", "ModbusTimeoutError"),
        Reading(0.0, "c", "nan", *classified(NAN)[:1], "", *classified(NAN)[1:]),
        Reading(0.0, "c", "bits", {"door": True, "mode": 5}, "", "good"),
        Reading(0.0, "c", "at", datetime(2026, 7, 1, 12, tzinfo=UTC), "", "good"),
    ]
    time = '"time": "1970-01-01T00:00:00.000Z"'
    assert as_json(readings).decode().splitlines() == [
        f'{{"device": "a,b", "name": "voltage", {time}, "value": 230.5, "unit": "V",'
        ' "quality": "good"}',
        f'{{"device": "ä", "name": "flags", {time}, "value": [true, false], "unit": "",'
        ' "quality": "good"}',
        f'{{"device": "c", "name": "rest", {time}, "value": null, "unit": "",'
        ' "quality": "down", "reason": "ModbusTimeoutError"}',
        f'{{"device": "c", "name": "nan", {time}, "value": null, "unit": "", "quality": "bad",'
        ' "reason": "Missing"}',
        f'{{"device": "c", "name": "bits", {time}, "value": {{"door": true, "mode": 5}},'
        ' "unit": "", "quality": "good"}',
        f'{{"device": "c", "name": "at", {time}, "value": "2026-07-01T12:00:00+00:00",'
        ' "unit": "", "quality": "good"}',
    ]
    assert as_csv(readings).decode().splitlines() == [
        '1970-01-01T00:00:00.000Z,"a,b",voltage,230.5,V,good,',
        '1970-01-01T00:00:00.000Z,ä,flags,"[true, false]",,good,',
        "1970-01-01T00:00:00.000Z,c,rest,,,down,ModbusTimeoutError",
        "1970-01-01T00:00:00.000Z,c,nan,,,bad,Missing",
        '1970-01-01T00:00:00.000Z,c,bits,"{""door"": true, ""mode"": 5}",,good,',
        "1970-01-01T00:00:00.000Z,c,at,2026-07-01T12:00:00+00:00,,good,",
    ]
