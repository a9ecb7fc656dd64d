"""
The past of a value, for the chart of a page: numbers and gaps, and which values stand for a span of
time if there are too many.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
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

SINCE = 1_700_000_000.0


def values(*numbers: Any, quality: str = "good") -> list[HistoricalValue]:
    return [HistoricalValue(SINCE + at, each, quality) for at, each in enumerate(numbers)]


def seconds(found: list[HistoricalValue]) -> list[float]:
    return [each.time - SINCE for each in found]


@pytest.mark.parametrize(("most", "spans"), [(3, 1), (5, 1), (6, 2), (29, 9), (30, 10)])
def test_each_of_equal_spans_has_its_extremes(most: int, spans: int) -> None:
    given = values(*range(100))
    found = seconds(thinned(given, SINCE, SINCE + 100, most))
    length = 100 / spans
    firsts = [-int(-at * length // 1) for at in range(spans + 1)]
    expected = [at for first, end in pairwise(firsts) for at in (first, end - 1)]
    assert found == expected


def test_as_many_as_may_be_are_all() -> None:
    given = values(*range(30))
    assert thinned(given, SINCE, SINCE + 30, 30) == given
    assert len(thinned(given, SINCE, SINCE + 30, 29)) == 18


def test_a_span_keeps_its_first_smallest_last_greatest_and_first_bad_value_in_order() -> None:
    given = values(5, 9, 1, 1, None, 9, "text", 5)
    assert seconds(thinned(given, SINCE, SINCE + 8, 3)) == [2, 4, 5]
    assert seconds(thinned(values(7, 7, 7, 7), SINCE, SINCE + 4, 3)) == [0, 3]
    assert seconds(thinned(values(4, 3, 2, 1), SINCE, SINCE + 4, 3)) == [0, 3]


def test_a_number_of_another_quality_is_no_extreme() -> None:
    bad = HistoricalValue(SINCE + 2.5, 1000, "invalid")
    given = [*values(1, 2, 3), bad]
    given.sort()
    assert seconds(thinned([*given, *values(1, 2, 3)[:0]], SINCE, SINCE + 3, 3)) == [0, 2, 2.5]


def test_values_at_the_end_belong_to_the_last_span() -> None:
    given = [HistoricalValue(SINCE + at, at, "good") for at in (0, 1, 2, 10, 10, 10, 10)]
    assert seconds(thinned(given, SINCE, SINCE + 10, 6)) == [0, 2, 10, 10]


def test_values_that_are_no_numbers_are_one_of_a_span() -> None:
    words = [HistoricalValue(SINCE + at, "on", "good") for at in range(10)]
    assert thinned(words, SINCE, SINCE + 10, 3) == words[:1]
    assert thinned([], 0.0, 0.0, 3) == []


def test_no_time_at_all_is_one_span() -> None:
    given = [HistoricalValue(SINCE, number, "good") for number in range(9)]
    assert [each.value for each in thinned(given, SINCE, SINCE, 3)] == [0, 8]


@pytest.mark.parametrize("most", [3, 1_000_000])
def test_three_values_to_a_million_may_be_asked_for(tmp_path: Path, most: int) -> None:
    with pytest.raises(JournalError):  # there is no such file
        history(str(tmp_path / "none.db"), "meter", "level", SINCE, SINCE + 1, most)


@pytest.mark.parametrize("most", [2, 1_000_001])
def test_another_number_of_values_is_refused(tmp_path: Path, most: int) -> None:
    with pytest.raises(ValueError, match="most"):
        history(str(tmp_path / "none.db"), "meter", "level", SINCE, SINCE + 1, most)


def test_numbers_and_gaps_of_a_value(tmp_path: Path) -> None:
    path = str(tmp_path / "fleet.db")
    file = JournalFile(path, 1e9, 10**9)
    file.open([])
    try:
        told = [(1, 5.5, "good"), (2, None, "down"), (3, "text", "good"), (4, 7, "good")]
        for at, value, quality in told:
            poll = [each._replace(time=float(at), value=value) for each in readings()]
            file.write(numbered([each._replace(quality=quality) for each in poll], at * 10), {}, 0)  # type: ignore[arg-type]
        assert past_in(path)("a", "p1", 0.0, 9.0, 100) == [
            (1.0, 5.5),
            (2.0, None),
            (3.0, None),
            (4.0, 7.0),
        ]
        assert past_in(path)("a", "p1", 3.5, 9.0, 100) == [(4.0, 7.0)]
    finally:
        file.close()


def test_a_journal_that_cannot_be_read_has_no_past(tmp_path: Path) -> None:
    assert past_in(str(tmp_path / "none.db"))("a", "p1", 0.0, 9.0, 100) == []
