"""
The samples of a value: bounded, with gaps, in the order of time, and their extremes.
"""

from __future__ import annotations

import math
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py.tools.page.samples import Samples, thinned
from tests.support.cases import each_case


def made(*values: Any, most: int = 10, start: float = 100.0) -> Samples:
    samples = Samples(most)
    for at, value in enumerate(values):
        samples.add(start + at, value)
    return samples


def test_the_latest_samples_are_kept_and_the_extremes_of_all() -> None:
    samples = made(50, *range(30), most=4)
    assert samples.pairs() == [(127, 26), (128, 27), (129, 28), (130, 29)]
    assert samples.pairs(since=128) == [(129, 28), (130, 29)]
    assert (samples.low, samples.high, len(samples)) == (0, 50, 4)


@each_case(
    "value",
    [None, "text", "12", math.nan, math.inf, -math.inf, [1, 2], {"a": 1}, 10**400, object()],
)
def test_what_is_no_number_is_a_gap(value: Any) -> None:
    samples = made(1, value, 3)
    assert [each for _, each in samples.pairs()] == [1, None, 3]
    assert samples.spark(60) == [0, -1, 20]
    assert (samples.low, samples.high) == (1, 3)


def test_bits_are_drawn_as_0_and_1() -> None:
    assert made(True, False, True).spark(60) == [20, 0, 20]


def test_a_sparkline_has_the_last_samples_also_after_the_ring_is_full() -> None:
    samples = made(*range(13), most=10)
    assert samples.spark(4) == [0, 6, 13, 20]
    assert samples.spark(60) == made(*range(3, 13)).spark(60)
    assert made(5, 5, None).spark(3) == [10, 10, -1]
    assert made(None, None).spark(3) == []
    assert made(-1e308, 1e308).spark(3) == [10, 10]  # the span is not a number


def test_samples_that_are_too_close_replace_each_other_but_a_gap_hides_no_number() -> None:
    samples = Samples()
    for time, value in [(1.0, 5), (1.1, 9), (1.2, None), (2.0, None), (2.1, 4)]:
        samples.add(time, value)
    assert samples.pairs() == [(1.0, 9), (2.0, 4)]
    assert (samples.low, samples.high) == (4, 9)


def test_a_clock_that_was_set_back_leaves_them_in_order() -> None:
    samples = Samples()
    for time, value in [(50.0, 1), (60.0, 2), (10.0, 3), (11.0, 4)]:
        samples.add(time, value)
    assert [time for time, _ in samples.pairs()] == [10, 11, 50, 60]


@given(st.lists(st.integers(0, 9), max_size=40), st.integers(2, 12), st.integers(2, 12))
def test_a_ring_that_is_resized_keeps_the_latest(values: list[int], most: int, then: int) -> None:
    samples = made(*values, most=most)
    samples.resize(then)
    expected = values[-most:][-then:]
    assert [each for _, each in samples.pairs()] == expected
    for at in range(20):
        samples.add(1000 + at, at)
    assert [each for _, each in samples.pairs()] == list(range(20))[-then:]


@given(st.lists(st.one_of(st.none(), st.integers(-99, 99)), max_size=300), st.integers(4, 60))
def test_thinned_samples_keep_extremes_gaps_and_order(values: list[int | None], most: int) -> None:
    pairs = [(float(at), value) for at, value in enumerate(values)]
    found = thinned(pairs, most)
    assert len(found) <= max(most, 4)
    assert found == sorted(found, key=lambda pair: pair[0])
    assert set(found) <= set(pairs)
    numbers = [each for each in values if each is not None]
    if numbers:
        kept = [each for _, each in found if each is not None]
        assert (min(kept), max(kept)) == (min(numbers), max(numbers))
    assert (None in values) == (None in [each for _, each in found])
