"""
Readings as polls with ids, and polls as rows of a file.
"""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.journal.schema import Points, decoded, encoded, numbered
from tests.services.fleet.journal.journals import readings
from tests.support.cases import each_case


def test_readings_become_polls_with_ids_in_order() -> None:
    mixed = [*readings("a", 1.0), *readings("b", 1.0), *readings("b", 2.0, 1)]
    found = list(numbered(mixed, 10))
    assert [(each.first, each.last) for each in found] == [(10, 11), (12, 13), (14, 14)]
    assert [one.id for each in found for one in each.readings] == [10, 11, 12, 13, 14]
    assert [one._replace(id=0) for each in found for one in each.readings] == mixed


POINTS = Points(5, 3, [("p0", "V"), ("p1", ""), ("p2", "W")])


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
    units = dict(POINTS.named)
    whole = [
        Reading(1.25, "a", name, value, units[name], "good", "", 20 + at)
        for at, (name, value) in enumerate(readings)
    ]
    whole[-1] = whole[-1]._replace(quality="bad", reason="Missing")
    [poll] = numbered(whole, 20)
    row = encoded(poll, POINTS)
    assert (row.id, row.readings, row.time, row.device, row.points) == (20, len(whole), 1.25, 3, 5)
    assert decoded(row, "a", {}, POINTS) == poll
    if len(whole) == 3:
        assert row.chosen is None


def test_a_point_that_is_not_in_the_list_is_an_error() -> None:
    [poll] = numbered([Reading(1.0, "a", "p9", 1, "", "good")], 1)
    with pytest.raises(KeyError):
        encoded(poll, POINTS)


def test_values_that_json_lacks_are_none_in_a_row() -> None:
    [poll] = numbered([Reading(1.0, "a", "p1", {"x": float("inf")}, "", "good")], 1)
    assert encoded(poll, POINTS).data == '[{"x":null}]'
