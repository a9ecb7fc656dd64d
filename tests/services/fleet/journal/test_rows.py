"""Polls as rows of a journal, places of outputs, and histories of values."""

import asyncio
from contextlib import closing
from typing import Any

import pytest

from libmodbus_py.services.fleet.journal.journal_file import JournalFile
from libmodbus_py.services.fleet.journal.journal_reader import (
    HistoricalValue,
    history,
    past_in,
    thinned,
)
from libmodbus_py.services.fleet.journal.place import JournalPlace
from libmodbus_py.services.fleet.journal.schema import (
    JournalError,
    JournalPoll,
    numbered,
)
from tests.services.fleet.fleets import in_simulated_time
from tests.services.fleet.journal.journals import polls, readings
from tests.support.cases import each_case

SINCE = 1_700_000_000.0


def at(time: float, value: Any, quality: str = "good") -> HistoricalValue:
    return HistoricalValue(SINCE + time, value, quality)


def values(*numbers: Any) -> list[HistoricalValue]:
    return [at(time, number) for time, number in enumerate(numbers)]


def times_of(values: list[HistoricalValue], length: float, most: int) -> list[float]:
    """Return the seconds of the values that stand for the others."""
    return [sample.time - SINCE for sample in thinned(values, SINCE, SINCE + length, most)]


@each_case(
    ("history", "length", "most", "times"),
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
def test_thinned_values_contain_the_extremes_of_each_span(history, length, most, times) -> None:
    assert times_of(history, length, most) == times


@each_case(
    ("most", "error", "message"),
    [
        (2, ValueError, "most"),
        (3, JournalError, "fleet.db"),
        (1_000_000, JournalError, "fleet.db"),
        (1_000_001, ValueError, "most"),
    ],
)
def test_a_history_returns_three_to_a_million_values(path: str, most, error, message) -> None:
    """There is no such file, so that what may be asked for ends with another error."""
    with pytest.raises(error, match=message):
        history(path, "meter", "level", SINCE, SINCE + 1, most)
    assert past_in(path)("meter", "level", SINCE, SINCE + 1, 100) == []


def test_a_history_returns_numbers_and_gaps_of_a_value(path: str) -> None:
    rows = [(1, 5.5, "good"), (2, None, "down"), (3, "text", "good"), (4, 7, "good")]
    past = past_in(path)
    with closing(JournalFile(path, 1e9, 10**9)) as file:
        file.open([])
        for at, value, quality in rows:
            poll = [reading._replace(time=float(at), value=value) for reading in readings()]
            file.write_polls(
                numbered([reading._replace(quality=quality) for reading in poll], at * 10), {}, 0
            )  # type: ignore[arg-type]
        assert past("a", "p1", 0.0, 9.0, 100) == [(1.0, 5.5), (2.0, None), (3.0, None), (4.0, 7.0)]
        assert past("a", "p1", 3.5, 9.0, 100) == [(4.0, 7.0)]


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
        behind = [poll for poll in self.polls if poll.first > number]
        return behind[:2], number


def place_in(journal: FakeJournal, confirmed: int, waiting: int) -> JournalPlace:
    return JournalPlace("x", journal, confirmed, waiting)


@in_simulated_time
async def test_an_output_that_confirms_twice_or_late_keeps_its_place() -> None:
    journal = FakeJournal(*polls(1, 4))
    place = place_in(journal, 0, 8)
    first, second = await place.take_polls(2), await place.take_polls(2)
    await place.confirm_readings(second)
    for old in (second, first, []):  # an output that confirms twice, or late
        await place.confirm_readings(old)
        place.drop_readings(old)
    assert (place.confirmed, place.dropped, journal.noted) == (4, 0, 1)
    place.put_back(first)
    third = await place.take_polls(2)
    assert [entry.id for entry in third] == [5, 6]
    dropped = place.dropped
    place.drop_readings(third)
    assert (place.confirmed, place.dropped) == (6, dropped + 2)
