"""
Polls as rows of a journal, the ids of readings, and the polls in memory.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.journal import place as recent
from libmodbus_py.services.fleet.journal.place import RecentPolls
from libmodbus_py.services.fleet.journal.schema import (
    MARGIN,
    Points,
    decoded,
    encoded,
    first_id,
    numbered,
)
from libmodbus_py.services.fleet.outputs.forms import COLUMNS, as_csv, as_json, object_text
from libmodbus_py.services.workers.messages import _messages
from tests.services.fleet.journal.journals import polls, readings
from tests.support.cases import each_case


def test_the_first_id_is_above_all_that_may_have_been_given() -> None:
    assert first_id(1.5, 0) == 1_500_000
    assert first_id(1e9, 7) == 10**15
    # The clock was set back, and the last readings were sent, but never came to the disk.
    assert first_id(0.0, 10**15) == 10**15 + MARGIN
    assert first_id(0.0, 0) == 1


def test_readings_become_polls_with_ids_in_order() -> None:
    mixed = [*readings("a", 1.0), *readings("b", 1.0), *readings("b", 2.0, 1)]
    found = list(numbered(mixed, 10))
    assert [(each.first, each.last) for each in found] == [(10, 11), (12, 13), (14, 14)]
    assert [one.id for each in found for one in each.readings] == [10, 11, 12, 13, 14]
    assert [one._replace(id=0) for each in found for one in each.readings] == mixed


NAMED = [("p0", "V"), ("p1", ""), ("p2", "W")]
POINTS = Points(5, 3, {each: at for at, each in enumerate(NAMED)})


@each_case(
    ("readings",),
    [
        ([("p0", 0.1), ("p1", 7), ("p2", 2**70)],),
        ([("p2", True), ("p0", None)],),
        ([("p1", "ä'\"; DROP TABLE poll --\0\ud800")],),
        ([("p1", [1, None, {"a": False}])],),
    ],
)
def test_a_row_gives_back_what_was_put_into_it(readings: Sequence[tuple[str, object]]) -> None:
    units = dict(NAMED)
    whole = [
        Reading(1.25, "a", name, value, units[name], "good", "", 20 + at)
        for at, (name, value) in enumerate(readings)
    ]
    whole[-1] = whole[-1]._replace(quality="bad", reason="Missing")
    [poll] = numbered(whole, 20)
    row = encoded(poll, POINTS)
    assert (row.id, row.readings, row.time, row.device, row.points) == (20, len(whole), 1.25, 3, 5)
    assert decoded(row, "a", {}, NAMED) == poll
    if len(whole) == 3:
        assert row.chosen is None


def test_a_point_that_is_not_in_the_list_is_an_error() -> None:
    [poll] = numbered([Reading(1.0, "a", "p9", 1, "", "good")], 1)
    with pytest.raises(KeyError):
        encoded(poll, POINTS)


def test_values_that_json_lacks_are_none_in_a_row() -> None:
    [poll] = numbered([Reading(1.0, "a", "p1", {"x": float("inf")}, "", "good")], 1)
    assert encoded(poll, POINTS).data == '[{"x":null}]'


def filled(first: int, count: int) -> RecentPolls:
    made = RecentPolls(first - 1)
    for each in polls(first, count):
        made.add(each)
    return made


def test_polls_are_taken_whole_and_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recent, "MOST_IN_MEMORY", 6)
    made, every = filled(10, 5), polls(10, 5)
    assert (made.before, made.last) == (9, 19)  # the file lacks them all
    assert made.after(9, 100) == every
    assert made.take(3) == every[:1]
    assert made.take(1) == every[1:2]  # one at least
    made.add(polls(20, 1)[0])
    assert (made.before, made.taken, made.dropped) == (13, 13, 0)
    assert made.after(12, 100) is None
    assert made.after(17, 3) == every[4:]
    assert made.after(21, 100) == []


def test_what_no_disk_takes_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recent, "MOST_IN_MEMORY", 4)
    monkeypatch.setattr(recent, "MOST_WAITING", 8)
    made = filled(1, 3)
    assert made.take(4) == polls(1, 2)
    for each in polls(7, 100):
        made.add(each)
    # Those that were taken before are on their way to the disk, and not lost.
    assert (made.last, made.dropped) == (206, 206 - 8 - 4)
    assert made.take(1000) == made.after(198, 1000) == polls(199, 4, time=196.0)
    assert made.take(1) == []


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
