"""
The past of a value, for the chart of a page: numbers and gaps, and which values stand for a span of
time if there are too many.
"""

from __future__ import annotations

from contextlib import closing
from itertools import pairwise
from typing import Any

import pytest

from libmodbus_py.services.fleet.journal.journal_file import JournalFile
from libmodbus_py.services.fleet.journal.journal_reader import (
    HistoricalValue,
    history,
    past_in,
    thinned,
)
from libmodbus_py.services.fleet.journal.schema import JournalError, numbered
from tests.services.fleet.journal.journals import readings
from tests.support.cases import each_case

SINCE = 1_700_000_000.0


def at(time: float, value: Any, quality: str = "good") -> HistoricalValue:
    return HistoricalValue(SINCE + time, value, quality)


def values(*numbers: Any) -> list[HistoricalValue]:
    return [at(time, number) for time, number in enumerate(numbers)]


def left(given: list[HistoricalValue], length: float, most: int) -> list[float]:
    """Return the seconds of the values that stand for the others."""
    return [each.time - SINCE for each in thinned(given, SINCE, SINCE + length, most)]


@pytest.mark.parametrize(("most", "spans"), [(3, 1), (5, 1), (6, 2), (29, 9), (30, 10)])
def test_each_of_equal_spans_has_its_extremes(most: int, spans: int) -> None:
    length = 100 / spans
    firsts = [-int(-number * length // 1) for number in range(spans + 1)]
    expected = [at for first, end in pairwise(firsts) for at in (first, end - 1)]
    assert left(values(*range(100)), 100, most) == expected


@each_case(
    ("given", "length", "most", "expected"),
    [
        (values(*range(30)), 30, 30, [*range(30)]),  # as many as may be are all
        # Of a span the first smallest, the last greatest, and the first bad one, in their order.
        (values(5, 9, 1, 1, None, 9, "text", 5), 8, 3, [2, 4, 5]),
        (values(7, 7, 7, 7), 4, 3, [0, 3]),
        (values(4, 3, 2, 1), 4, 3, [0, 3]),
        (values(*["on"] * 10), 10, 3, [0]),
        # A number of another quality is no extreme.
        ([*values(1, 2, 3), at(2.5, 1000, "invalid")], 3, 3, [0, 2, 2.5]),
        # Values at the end belong to the last span.
        ([at(time, time) for time in (0, 1, 2, 7, 10, 10, 10)], 10, 6, [0, 2, 7, 10]),
        ([], 0, 3, []),
    ],
)
def test_some_values_stand_for_others(
    given: list[HistoricalValue], length: float, most: int, expected: list[float]
) -> None:
    assert left(given, length, most) == expected


def test_no_time_at_all_is_one_span() -> None:
    given = [at(0, number) for number in range(9)]
    assert [each.value for each in thinned(given, SINCE, SINCE, 3)] == [0, 8]


@each_case(
    ("most", "error", "said"),
    [
        (2, ValueError, "most"),
        (3, JournalError, "fleet.db"),
        (1_000_000, JournalError, "fleet.db"),
        (1_000_001, ValueError, "most"),
    ],
)
def test_three_values_to_a_million_may_be_asked_for(
    path: str, most: int, error: type[Exception], said: str
) -> None:
    """There is no such file, so that what may be asked for ends with another error."""
    with pytest.raises(error, match=said):
        history(path, "meter", "level", SINCE, SINCE + 1, most)
    assert past_in(path)("meter", "level", SINCE, SINCE + 1, 100) == []


def test_numbers_and_gaps_of_a_value(path: str) -> None:
    told = [(1, 5.5, "good"), (2, None, "down"), (3, "text", "good"), (4, 7, "good")]
    past = past_in(path)
    with closing(JournalFile(path, 1e9, 10**9)) as file:
        file.open([])
        for at, value, quality in told:
            poll = [each._replace(time=float(at), value=value) for each in readings()]
            rows = [each._replace(quality=quality) for each in poll]  # type: ignore[arg-type]
            file.write_polls(numbered(rows, at * 10), {}, 0)
        assert past("a", "p1", 0.0, 9.0, 100) == [(1.0, 5.5), (2.0, None), (3.0, None), (4.0, 7.0)]
        assert past("a", "p1", 3.5, 9.0, 100) == [(4.0, 7.0)]
