"""
Which points are due at a poll.
"""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py import Point, RegisterMap
from libmodbus_py.maps.pace import PointIntervals
from tests.support.cases import each_case


def polled(pace: PointIntervals, polls: int, late: float = 0.0) -> list[list[float]]:
    """Return the times at which each of two points is read."""
    found: list[list[float]] = [[], []]
    for number in range(polls):
        now = number * pace.interval
        due = pace.due(now + late * (number % 2))
        for at in (0, 1) if due is None else due:
            found[at].append(now)
        pace.done()
    return found


def test_a_point_is_read_at_its_own_interval() -> None:
    assert polled(PointIntervals([None, 60], 10), 13) == [
        [10.0 * at for at in range(13)],
        [0, 60, 120],
    ]


def test_polls_come_at_the_shortest_interval() -> None:
    pace = PointIntervals([None, 2], 10)
    assert pace.interval == 2
    assert polled(pace, 6) == [[0, 10], [0, 2, 4, 6, 8, 10]]


def test_an_interval_ends_at_the_nearest_poll_and_does_not_drift() -> None:
    _, found = polled(PointIntervals([None, 25], 10), 1001)
    assert found[:5] == [0, 20, 50, 70, 100]
    assert len(found) == 401


def test_polls_that_come_late_change_nothing() -> None:
    assert polled(PointIntervals([None, 60], 10), 13, late=0.9)[1] == [0, 60, 120]


@given(
    own=st.lists(st.none() | st.floats(0.01, 86_400), min_size=1, max_size=5),
    steps=st.lists(st.floats(0, 1e6), max_size=20),
)
def test_something_is_due_at_every_poll(own: list[float | None], steps: list[float]) -> None:
    pace, now = PointIntervals(own, 10), 0.0
    for step in steps:
        now += step
        due = pace.due(now)
        assert due is None or (due and set(due) <= set(range(len(own))))
        pace.done()


def test_points_without_an_answer_are_read_at_the_next_poll_once() -> None:
    pace = PointIntervals([None, 60], 10)
    assert pace.due(0) is None
    pace.done([1])
    assert pace.due(10) is None
    pace.done([1])
    assert [pace.due(now) for now in (20, 30, 40)] == [(0,)] * 3


def test_without_any_answer_all_stay_due() -> None:
    pace = PointIntervals([None, 60], 10)
    for now in range(0, 100, 10):
        assert pace.due(now) is None
        pace.done([0, 1])
    assert pace.due(100) is None
    pace.done()
    assert pace.due(110) == (0,)


MAP = RegisterMap(
    [
        Point("a", "holding_registers", 0, group="x"),
        Point("b", "holding_registers", 1, group="y"),
        Point("c", "holding_registers", 2, group="x"),
        Point("d", "holding_registers", 3, group="x", access="write"),
        Point("e", "holding_registers", 4, group="z", access="write"),
    ]
)


def test_a_group_has_the_points_that_can_be_read() -> None:
    assert MAP.group("x") == ["a", "c"]


@each_case("name", ["", "z", "X"])
def test_an_unknown_group_is_named(name: str) -> None:
    with pytest.raises(ValueError, match=f"no points of a group '{name}'; its groups are x, y"):
        MAP.group(name)
