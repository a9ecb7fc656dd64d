"""
Totals that are smaller than before: read again once, then believed.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py.maps.watched import Totals


def falls(*polls: Any) -> list[str]:
    """Return for each poll of one total whether it is believed, doubtful, or fell."""
    totals = Totals([0])
    found = []
    for value in polls:
        doubtful, fell = totals.take([value])
        found.append("doubtful" if doubtful else "fell" if fell else "believed")
    return found


def test_a_total_that_falls_is_read_again_once() -> None:
    assert falls(10, 11, 3, 3) == ["believed", "believed", "doubtful", "fell"]
    assert falls(10, 3, 2, 3) == ["believed", "doubtful", "fell", "believed"]


def test_a_total_that_fell_for_one_poll_is_forgotten() -> None:
    assert falls(10, 0, 11, 5) == ["believed", "doubtful", "believed", "doubtful"]


def test_what_is_no_number_is_no_total() -> None:
    assert falls(10, ValueError(), 10, 9) == ["believed"] * 3 + ["doubtful"]
    assert falls(10, 9, None, 9) == ["believed", "doubtful", "believed", "fell"]


def test_other_points_are_not_looked_at() -> None:
    totals = Totals([1])
    for values in ([5, 10], [4, 11]):
        assert totals.take(values) == (frozenset(), frozenset())
    assert totals.take([3, 10]) == (frozenset({1}), frozenset())
    assert totals.before(1) == 11


@given(st.lists(st.integers(0, 5)))
def test_no_total_is_doubtful_twice_in_a_row(polls: list[int]) -> None:
    found = falls(*polls)
    assert ("doubtful", "doubtful") not in list(pairwise(found))
    rises = all(first <= second for first, second in pairwise(polls))
    assert not rises or set(found) <= {"believed"}
