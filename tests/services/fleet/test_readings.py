"""Readings: what the registers of a point mean, which values are told, and how they are written."""

import json
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
    NoValue,
    Point,
    RegisterMap,
)
from libmodbus_py.fleet import DeviceConfig, Reading
from libmodbus_py.services.fleet.outputs.forms import as_csv, as_json, object_text, poll_messages
from libmodbus_py.services.fleet.poller import Poller
from libmodbus_py.services.fleet.readings import Changes, classification, is_down
from tests.support.cases import each_case

NAN = math.nan


def told(values: list[Any], *, on_change: bool = False, band: float | None = None) -> list[Any]:
    changes = Changes(on_change, [band])
    return [value for value in values if list(changes.pick([value]))]


@pytest.mark.parametrize(
    ("options", "values", "reports"),
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
def test_a_value_is_reported_when_the_options_say_so(options, values, reports) -> None:
    assert repr(told(values, **options)) == repr(reports)


@pytest.mark.parametrize("options", [{}, {"on_change": True}, {"band": 5.0}])
def test_a_bad_quality_is_reported_when_it_begins_and_when_it_ends(options: Any) -> None:
    down, other = ModbusTimeoutError("no answer"), IllegalDataAddress()
    values = [down, down, other, other, down, 7]
    assert told(values, **options) == [down, other, down, 7]
    assert told([7, down, 7], **options) == [7, down, 7]


DOWN = ModbusTimeoutError("no answer")


@each_case(
    ("options", "values", "polls"),
    [
        # At 0, 20, 40 and so on: the last poll that is not too late, and one after each change.
        ({"on_change": True, "at_least": 60}, [7] * 8, [0, 3, 6]),
        ({"on_change": True, "at_least": 59.9}, [7] * 8, [0, 2, 4, 6]),
        ({"on_change": True, "at_least": 60}, [7, 7, 8, 8, 8, 8, 8], [0, 2, 5]),
        ({"dead_bands": {"x": 5}, "at_least": 40}, [7, 8, 9, 9, 9, 10], [0, 2, 4]),
        ({"on_change": True, "at_least": 0.5}, [7] * 3, [0, 1, 2]),
        ({"on_change": True}, [7] * 8, [0]),
        ({"at_least": 600}, [7] * 3, [0, 1, 2]),
        ({"at_least": 60}, [DOWN] * 5, [0, 3]),
        ({"on_change": True, "at_least": 60}, [7, DOWN, DOWN, DOWN, DOWN, 7, 7], [0, 1, 4, 5]),
    ],
)
def test_a_point_is_reported_at_least_at_its_longest_interval(options, values, polls) -> None:
    point = Point("x", "holding_registers", 0)
    device = DeviceConfig("a", "tcp://192.0.2.1", RegisterMap([point]), interval=20, **options)
    poller = Poller(device)
    reported = []
    for number, value in enumerate(values):
        at = 1000.1 + 20 * number
        poller.begin(at)
        poller.take_outcome(value if isinstance(value, Exception) else [value], at)
        reported += [number] * len(poller.readings(at, 0))
    assert reported == polls


def test_a_point_with_its_own_interval_is_reported_at_least_at_its_longest_interval() -> None:
    points = [Point("x", "holding_registers", 0, interval=40), Point("y", "holding_registers", 1)]
    device = DeviceConfig(
        "a", "tcp://192.0.2.1", RegisterMap(points), interval=20, on_change=True, at_least=100
    )
    poller = Poller(device)
    reported: dict[str, list[int]] = {"x": [], "y": []}
    for at in range(0, 220, 20):
        poller.begin(at)
        assert poller.request is not None
        poller.take_outcome([7] * poller.request.count, at)
        for reading in poller.readings(at, 0):
            reported[reading.name].append(at)
    assert reported == {"x": [0, 80, 160], "y": [0, 100, 200]}


@pytest.mark.parametrize(
    ("error", "is_so"),
    [
        (ModbusTimeoutError("no answer"), True),
        (ModbusConnectionError("lost"), True),
        (GatewayTargetFailedToRespond(), True),
        (IllegalDataAddress(), False),
        (FrameError("noise"), False),
        (InvalidResponse("unit 3 answered"), False),
        (NoValue("level", "InvalidData", "has no value"), False),
    ],
)
def test_a_unit_without_an_answer_is_down(error: Exception, is_so: bool) -> None:
    assert is_down(error) is is_so


def test_readings_are_formatted_as_text() -> None:
    readings = [
        Reading(0.0, "a,b", "voltage", 230.5, "V", "good"),
        Reading(0.0, "ä", "flags", [True, False], "", "good"),
        Reading(0.0, "c", "rest", None, "", "down", "ModbusTimeoutError"),
        Reading(0.0, "c", "nan", *classification(NAN)[:1], "", *classification(NAN)[1:]),
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


@pytest.mark.parametrize("value", [1, -2.5, True, None, 'ü\x07"', [1, None], {"a": 1.5}, 1e300])
@pytest.mark.parametrize("number", [0, 7])
def test_the_text_of_a_reading_contains_its_json_object(value: Any, number: int) -> None:
    reading = Reading(1e9, "a", "b", value, "°C", "bad", 'No "value"', number, {"site": "ü"})
    row = json.loads(object_text(reading))
    time = "2001-09-09T01:46:40.000Z"
    fields = {"time": time, "value": value, "unit": "°C", "quality": "bad", "reason": 'No "value"'}
    assert row == {**fields, **({"id": number} if number else {}), "labels": {"site": "ü"}}


def test_no_message_is_larger_than_the_limit() -> None:
    readings = [Reading(100.0, "a", f"p{at}", at, "V", "good") for at in range(100)]
    for largest in range(1024, 1300):
        messages = list(poll_messages(readings, largest))
        assert max(len(data) for _, data in messages) <= largest
        assert sum(len(names) for names, _ in messages) == 100


H = "holding_registers"


def point(name: str, address: int, **keys: Any) -> Point:
    return Point(name, H, address, **keys)


POINTS = RegisterMap(
    [
        point("v", 0, type="int16", scale_from="v_sf", plausible_maximum=500),
        point("state", 1, states={0: "off", 1: "on"}, missing=255),
        point("flags", 2, bits={0: "door", "4..7": "mode"}),
        point("total", 3, never_falls=True),
        point("v_sf", 4, type="int16"),
        point("current", 5, type="float32"),
    ]
)

DEVICE = DeviceConfig(
    "meter", "tcp://192.0.2.10", POINTS, items=("v", "state", "flags", "total", "current")
)


class Polls:
    """A device that is polled, one answer after the other."""

    def __init__(self) -> None:
        self._poller = Poller(DEVICE)

    def readings(self, *cells: int) -> list[Reading]:
        self._poller.begin()
        while self._poller.request is not None:
            self._poller.take_outcome(list(cells), 0.0)
        return self._poller.readings(0.0, 0)


def values(*cells: int) -> dict[str, tuple[Any, str, str]]:
    return {reading.name: (reading.value, *reading[5:7]) for reading in Polls().readings(*cells)}


def test_readings_have_decoded_values() -> None:
    assert values(2305, 1, 0x51, 7, 0xFFFF, 0x3F80, 0) == {
        "v": (230.5, "good", ""),
        "state": ("on", "good", ""),
        "flags": ({"door": True, "mode": 5}, "good", ""),
        "total": (7, "good", ""),
        "current": (1.0, "good", ""),
    }


def test_a_reading_without_a_value_is_bad_and_has_a_reason() -> None:
    readings = values(5001, 255, 0, 0, 0xFFFF, 0x7FC0, 0)
    assert readings["v"] == (None, "bad", "Implausible")
    assert readings["state"] == (None, "bad", "Missing")
    assert readings["current"] == (None, "bad", "Missing")
    assert values(5001, 0, 0, 0, 300, 0x7F80, 0)["v"] == (None, "bad", "BadScale")
    assert values(5001, 0, 0, 0, 300, 0x7F80, 0)["current"] == (None, "bad", "Infinite")


def test_a_total_that_falls_is_reported_when_it_was_read_again() -> None:
    polls = Polls()

    def total(value: int) -> list[tuple[Any, str, str]]:
        readings = polls.readings(1, 0, 0, value, 0, 0, 0)
        return [(reading.value, *reading[5:7]) for reading in readings if reading.name == "total"]

    assert total(10) == [(10, "good", "")]
    assert total(3) == []
    assert total(4) == [(4, "good", "Fell")]
    assert total(5) == [(5, "good", "")]
    assert total(0) == []
    assert total(6) == [(6, "good", "")]


@each_case(
    ("items", "reading"),
    [
        ([1.5, 2.5], ([1.5, 2.5], "good", "")),
        ([1.5, None], ([1.5, None], "good", "Missing")),
        ([math.inf, 2.5, None], ([None, 2.5, None], "good", "Infinite")),
        ([math.nan, None], (None, "bad", "Missing")),
        ([True, False], ([True, False], "good", "")),
    ],
)
def test_missing_values_of_a_list_have_reasons(items: list[Any], reading: tuple[Any, str, str]):
    assert classification(items) == reading
