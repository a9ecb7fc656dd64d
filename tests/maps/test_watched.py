"""Points from poll to poll: which are due, totals that fall, and what a poll of a map reads."""

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py import IllegalDataAddress, ModbusTimeoutError, Point, RegisterMap
from libmodbus_py.maps.watched import (
    MOST_PLANS,
    PartialPlans,
    PointIntervals,
    Totals,
    WatchedPoints,
)
from tests.support.cases import each_case


def polled(pace: PointIntervals, polls: int) -> list[list[float]]:
    """Return the times at which each of two points is read."""
    times: list[list[float]] = [[], []]
    for number in range(polls):
        at = number * pace.interval
        due = pace.due(at)
        for index in (0, 1) if due is None else due:
            times[index].append(at)
        pace.done()
    return times


@each_case(
    ("interval", "usual", "times"),
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
def test_an_interval_ends_with_the_first_poll_at_or_after_it(interval, usual, times) -> None:
    _, polls = polled(PointIntervals([None, interval], usual), 100)
    assert polls[: len(times)] == pytest.approx(times)


def test_rounding_of_added_times_changes_no_interval() -> None:
    """A fleet adds its interval to the time of the last poll, for months."""
    pace, at, times = PointIntervals([None, 60], 0.1), 1e6, []
    for _ in range(6001):
        if pace.due(at) is None:
            times.append(at - 1e6)
        pace.done()
        at += 0.1
    assert times == pytest.approx([60 * number for number in range(11)], abs=0.01)


def test_polls_that_are_left_out_count_in_the_time() -> None:
    pace = PointIntervals([None, 60], 10)
    times = [0, 10, 50, 90, 140, 150]
    ends = []
    for at in times:
        if pace.due(at) is None:
            ends.append(at)
        pace.done()
    assert ends == [0, 90, 150]


def falls(*polls: Any) -> list[str]:
    """Return for each poll of one total whether it is believed, doubtful, or fell."""
    totals = Totals([0])
    verdicts = []
    for value in polls:
        doubtful, fell = totals.take([value])
        verdicts.append("doubtful" if doubtful else "fell" if fell else "believed")
    return verdicts


def test_errors_and_none_are_not_compared_as_totals() -> None:
    assert falls(10, ValueError(), 10, 9) == ["believed"] * 3 + ["doubtful"]
    assert falls(10, 9, None, 9) == ["believed", "doubtful", "believed", "fell"]


@given(st.lists(st.integers(0, 5)))
def test_a_total_is_never_doubtful_twice_in_a_row(polls: list[int]) -> None:
    verdicts = falls(*polls)
    assert ("doubtful", "doubtful") not in list(pairwise(verdicts))
    rises = all(first <= second for first, second in pairwise(polls))
    assert not rises or set(verdicts) <= {"believed"}


POINTS = RegisterMap(
    [
        Point("fast", "holding_registers", 0),
        Point("slow", "holding_registers", 1, interval=60),
        Point("total", "holding_registers", 2, never_falls=True),
    ]
)


def poll(watched: WatchedPoints, at: float, *answers: dict[str, Any]) -> tuple[list[Any], Any]:
    """Poll once; return the names of the points that each plan reads, and the values."""
    steps, read = watched.poll(at), []
    plan = next(steps)
    try:
        for answer in answers:
            read.append(list(plan.names))
            plan = steps.send({name: answer[name] for name in plan.names})
    except StopIteration as done:
        return read, done.value
    raise AssertionError("more is read")


def test_a_total_that_falls_is_read_again_alone_and_named_if_it_fell() -> None:
    watched = WatchedPoints(POINTS, ["total", "fast"], 10)
    assert poll(watched, 0, {"fast": 1, "total": 9})[1].fell == frozenset()
    read, values = poll(watched, 10, {"fast": 2, "total": 3}, {"total": 10})
    assert (read, values, values.fell) == (
        [["total", "fast"], ["total"]], {"total": 10, "fast": 2}, frozenset(),
    )  # fmt: skip
    _, values = poll(watched, 20, {"fast": 2, "total": 3}, {"total": 4})
    assert (values["total"], values.fell) == (4, {"total"})


@each_case(
    ("error", "is_read_again"), [(ModbusTimeoutError(""), True), (IllegalDataAddress(), False)]
)
def test_a_lost_value_is_read_again_and_a_refused_one_is_not(error, is_read_again) -> None:
    watched = WatchedPoints(POINTS, ["fast", "slow"], 10)
    poll(watched, 0, {"fast": 1, "slow": error})
    read, _ = poll(watched, 10, {"fast": 1, "slow": 2})
    assert read == [["fast", "slow"] if is_read_again else ["fast"]]


def test_plans_for_sets_of_points_are_kept_and_not_too_many() -> None:
    points = [Point(f"p{at}", "holding_registers", at) for at in range(MOST_PLANS + 1)]
    plans = PartialPlans(RegisterMap(points), None)
    first = plans.plan_of((0,))
    for at in range(1, MOST_PLANS):
        assert plans.plan_of((at,)).names == (f"p{at}",)
    assert plans.plan_of((0,)) is first
    plans.plan_of((MOST_PLANS,))
    assert plans.plan_of((0,)) is not first
    assert plans.plan_of(None) is plans.plan
