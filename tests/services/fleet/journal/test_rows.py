"""Polls as rows of a journal, places of outputs, and histories of values."""

import asyncio
from collections.abc import Sequence
from contextlib import closing
from itertools import pairwise
from typing import Any

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.journal.journal_file import JournalFile
from libmodbus_py.services.fleet.journal.journal_reader import (
    HistoricalValue,
    history,
    past_in,
    thinned,
)
from libmodbus_py.services.fleet.journal.place import JournalPlace
from libmodbus_py.services.fleet.journal.schema import (
    MARGIN,
    JournalError,
    JournalPoll,
    Points,
    decoded,
    encoded,
    first_id,
    numbered,
)
from tests.services.fleet.fleets import in_simulated_time
from tests.services.fleet.journal.journals import polls, readings
from tests.support.cases import each_case


def test_the_first_id_is_above_all_that_may_have_been_given() -> None:
    assert first_id(1.5, 0) == 1_500_000
    assert first_id(1e9, 7) == 10**15
    # The clock was set back, and the last readings were sent, but never came to the disk.
    assert first_id(0.0, 10**15) == 10**15 + MARGIN
    assert first_id(0.0, 0) == 1


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


def test_values_that_json_lacks_are_none_in_a_row() -> None:
    [poll] = numbered([Reading(1.0, "a", "p1", {"x": float("inf")}, "", "good")], 1)
    assert encoded(poll, POINTS).data == '[{"x":null}]'


class FakeJournal:
    """A journal that has these polls, and no others between them."""

    def __init__(self, *every: JournalPoll) -> None:
        self.polls = list(every)
        self.last = every[-1].last if every else 0
        self.noted = 0
        self.is_stuck = False

    def note_places(self) -> asyncio.Future[None]:
        self.noted += 1
        noted = asyncio.get_running_loop().create_future()
        if not self.is_stuck:
            noted.set_result(None)
        return noted

    async def after(self, number: int, most: int) -> tuple[list[JournalPoll], int]:
        behind = [each for each in self.polls if each.first > number]
        return behind[:2], number


def place_in(journal: FakeJournal, confirmed: int, waiting: int) -> JournalPlace:
    return JournalPlace("x", journal, confirmed, waiting)


@in_simulated_time
async def test_an_output_that_confirms_twice_or_late_goes_on_where_it_was() -> None:
    journal = FakeJournal(*polls(1, 4))
    place = place_in(journal, 0, 8)
    first, second = await place.take_polls(2), await place.take_polls(2)
    await place.confirm_readings(second)
    for old in (second, first, []):  # an output that confirms twice, or late
        await place.confirm_readings(old)
        place.drop_readings(old)
    assert (place.confirmed, place.dropped, journal.noted) == (4, 0, 1)
    place.put_back(first)
    assert [each.id for each in await place.take_polls(2)] == [5, 6]


@in_simulated_time
async def test_a_disk_that_notes_nothing_delays_an_output_by_a_second() -> None:
    journal = FakeJournal(*polls(1, 4))
    journal.is_stuck = True
    place = place_in(journal, 0, 8)
    loop = asyncio.get_running_loop()
    begun = loop.time()
    await place.confirm_readings(await place.take_polls(2))
    assert loop.time() - begun == pytest.approx(1.0)


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
def test_thinned_values_contain_the_extremes_of_each_span(
    given: list[HistoricalValue], length: float, most: int, expected: list[float]
) -> None:
    assert left(given, length, most) == expected


def test_a_range_of_no_time_is_one_span() -> None:
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
            file.write_polls(
                numbered([each._replace(quality=quality) for each in poll], at * 10), {}, 0
            )  # type: ignore[arg-type]
        assert past("a", "p1", 0.0, 9.0, 100) == [(1.0, 5.5), (2.0, None), (3.0, None), (4.0, 7.0)]
        assert past("a", "p1", 3.5, 9.0, 100) == [(4.0, 7.0)]
