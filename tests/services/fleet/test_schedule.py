"""
When devices are polled: phases, skipping, pauses, the heap. No clock.
"""

from __future__ import annotations

import subprocess
import sys
import weakref

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py.services.fleet.line import (
    Timetable,
    first_time,
    next_time,
)


class Member:
    """What a timetable contains."""


def test_phases_are_spread_evenly() -> None:
    """Ten thousand devices each 5 s: in no tenth of a second begin twice as many as should."""
    times = [first_time(f"device {number}", 5.0, 100.0, 1e9) for number in range(10_000)]
    assert all(100.0 <= each < 105.0 for each in times)
    counts = [0] * 50
    for each in times:
        counts[int((each - 100.0) * 10)] += 1
    assert 100 < min(counts) <= max(counts) < 300


def test_phases_are_those_of_another_machine() -> None:
    """Another process, whose steady clock began elsewhere: the same moments of the day."""
    wall = 1_800_000_000.25
    here = first_time("pump 7", 10.0, 5.0, wall) - 5.0 + wall
    program = f"""
from libmodbus_py.services.fleet.line import first_time
print(repr(first_time("pump 7", 10.0, 9e5, {wall} + 3.0) - 9e5 + {wall} + 3.0))
"""
    there = float(subprocess.check_output([sys.executable, "-c", program]))
    assert (here - there) % 10.0 == pytest.approx(0, abs=1e-3) or (here - there) % 10.0 > 9.999


@pytest.mark.parametrize(
    ("planned", "now", "expected"),
    [
        (10.0, 10.0, (11.0, 0)),
        (10.0, 10.4, (11.0, 0)),
        (10.0, 10.999, (11.0, 0)),
        (10.0, 11.0, (12.0, 1)),  # 11 is now, and polled as 10 is
        (10.0, 13.5, (14.0, 3)),
        (10.0, 9.9, (11.0, 0)),  # a timer that rings too early
    ],
)
def test_times_that_have_passed_are_skipped(
    planned: float, now: float, expected: tuple[float, int]
) -> None:
    assert next_time(planned, 1.0, now) == expected


@given(st.floats(0, 1e6), st.floats(0.01, 86_400), st.floats(0, 1e6))
def test_the_next_time_is_later_and_in_phase(planned: float, interval: float, late: float) -> None:
    now = planned + late
    at, missed = next_time(planned, interval, now)
    assert at > now or at == pytest.approx(now)
    assert at == pytest.approx(planned + (missed + 1) * interval)
    assert missed >= 0


def test_who_is_due_comes_in_the_order_of_times() -> None:
    table: Timetable[str] = Timetable()
    for name, at in (("late", 3.0), ("first", 1.0), ("second", 2.0)):
        table.put(name, at)
    assert table.next_at == 1.0
    assert table.due(0.9, 10) == []
    assert table.due(2.0, 10) == [(1.0, "first"), (2.0, "second")]
    assert table.next_at == 3.0


def test_at_most_so_many_at_once() -> None:
    table: Timetable[int] = Timetable()
    for number in range(10):
        table.put(number, number)
    assert len(table.due(100, 4)) == 4
    assert len(table) == 6
    assert len(table.due(100, 40)) == 6
    assert table.next_at is None
    assert len(table) == 0


def test_each_has_one_place() -> None:
    table: Timetable[str] = Timetable()
    table.put("a", 1.0)
    table.put("a", 5.0)
    assert table.next_at == 5.0
    table.put("a", 6.0)
    assert table.due(5.5, 10) == []
    assert table.next_at == 6.0
    table.remove("a")
    table.remove("never there")
    assert table.due(9.0, 10) == []
    assert len(table) == 0


def test_moving_for_ever_takes_no_memory() -> None:
    table: Timetable[int] = Timetable()
    for at in range(10_000):
        table.put(1, at)
        table.put(2, at)
        table.remove(2)
    assert len(table._heap) < 1000
    assert table.due(1e9, 10) == [(9999, 1)]


def test_those_that_are_left_keep_their_order() -> None:
    table: Timetable[int] = Timetable()
    for number in range(1000):
        table.put(number, number * 337 % 1000)
    for number in range(1000):
        if number % 10:
            table.remove(number)
    assert len(table) == 100
    expected = sorted((number * 337 % 1000, number) for number in range(0, 1000, 10))
    assert table.due(1000, 1000) == expected


def test_members_that_are_removed_leave_the_memory() -> None:
    """Thousands of devices are replaced at once."""
    table: Timetable[Member] = Timetable()
    members = [Member() for _ in range(1000)]
    known = [weakref.ref(each) for each in members]
    for at, each in enumerate(members):
        table.put(each, 1e6 + at)
    for each in members:
        table.remove(each)
    del members, each
    assert sum(each() is not None for each in known) <= 100


def test_a_member_that_was_moved_a_thousand_times_leaves_the_memory() -> None:
    table: Timetable[Member] = Timetable()
    member = Member()
    known = weakref.ref(member)
    for at in range(1000):
        table.put(member, 1e6 + at)
    table.remove(member)
    del member
    assert known() is None
