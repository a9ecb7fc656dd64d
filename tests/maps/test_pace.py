"""
Which points are due at a poll.
"""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py import Point, RegisterMap
from libmodbus_py.maps.watched import PointIntervals
from tests.support.cases import each_case


def polled(pace: PointIntervals, polls: int) -> list[list[float]]:
    """Return the times at which each of two points is read."""
    found: list[list[float]] = [[], []]
    for number in range(polls):
        at = number * pace.interval
        due = pace.due(at)
        for index in (0, 1) if due is None else due:
            found[index].append(at)
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


@each_case(
    ("interval", "usual", "expected"),
    [
        (25, 10, [0, 30, 60, 90]),  # not 0, 20, 50, which is sooner
        (20.1, 10, [0, 30, 60, 90]),
        (19.95, 10, [0, 20, 40, 60]),
        (10.5, 10, [0, 20, 40, 60]),
        (0.3, 0.1, [0, 0.3, 0.6, 0.9]),  # in binary fractions, 3 * 0.1 is more than 0.3
        (0.7, 0.1, [0, 0.7, 1.4, 2.1]),
        (86_400, 0.01, [0]),
    ],
)
def test_an_interval_ends_at_the_first_poll_that_is_not_sooner(
    interval: float, usual: float, expected: list[float]
) -> None:
    _, found = polled(PointIntervals([None, interval], usual), 100)
    assert found[: len(expected)] == pytest.approx(expected)


def test_sums_of_times_are_never_exact() -> None:
    """A fleet adds its interval to the time of the last poll, for months."""
    pace, at, found = PointIntervals([None, 60], 0.1), 1e6, []
    for _ in range(6001):
        if pace.due(at) is None:
            found.append(at - 1e6)
        pace.done()
        at += 0.1
    assert found == pytest.approx([60 * each for each in range(11)], abs=0.01)


def test_polls_that_are_left_out_count_as_time() -> None:
    pace = PointIntervals([None, 60], 10)
    times = [0, 10, 50, 90, 140, 150]
    found = []
    for at in times:
        if pace.due(at) is None:
            found.append(at)
        pace.done()
    assert found == [0, 90, 150]


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
