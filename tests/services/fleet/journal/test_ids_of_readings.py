"""
The ids of readings: in every form of them that a consumer of repeats uses, and in no other.
"""

from __future__ import annotations

import json

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs.forms import COLUMNS, as_csv, as_json, object_text
from libmodbus_py.services.workers.stream import _messages

NUMBERED = Reading(100.0, "a", "voltage", 230.5, "V", "good", "", 17)
DOWN = Reading(100.0, "a", "power", None, "W", "down", "ModbusTimeoutError", 18)


def test_json_has_the_id_of_a_reading_that_has_one() -> None:
    lines = as_json([NUMBERED, DOWN]).decode().splitlines()
    assert [json.loads(line)["id"] for line in lines] == [17, 18]
    assert [json.loads(object_text(each))["id"] for each in (NUMBERED, DOWN)] == [17, 18]
    [(_, _, message)] = _messages([NUMBERED, DOWN], 10_000)
    assert [each["id"] for each in json.loads(message)["values"].values()] == [17, 18]


def test_json_has_no_id_without_a_journal() -> None:
    bare = [each._replace(id=0) for each in (NUMBERED, DOWN)]
    assert all("id" not in json.loads(line) for line in as_json(bare).decode().splitlines())
    assert all("id" not in object_text(each) for each in bare)
    assert as_json(bare) == (
        b'{"device": "a", "name": "voltage", "time": "1970-01-01T00:01:40.000Z",'
        b' "value": 230.5, "unit": "V", "quality": "good"}\n'
        b'{"device": "a", "name": "power", "time": "1970-01-01T00:01:40.000Z",'
        b' "value": null, "unit": "W", "quality": "down", "reason": "ModbusTimeoutError"}\n'
    )


def test_columns_of_csv_are_the_same_with_a_journal() -> None:
    assert "id" not in COLUMNS
    assert as_csv([NUMBERED]) == as_csv([NUMBERED._replace(id=0)])
    assert len(as_csv([NUMBERED]).decode().split(",")) == len(COLUMNS)
