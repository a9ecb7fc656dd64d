"""
The rules of journals that need no file: ids, places, what is in memory, and thinned histories.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.journal.journal_reader import HistoricalValue, thinned
from libmodbus_py.services.fleet.journal.numbers import MARGIN, Unused, first_id
from libmodbus_py.services.fleet.journal.place import JournalPlace
from libmodbus_py.services.fleet.journal.polls import (
    JournalPoll,
    Points,
    decoded,
    encoded,
    numbered,
)
from libmodbus_py.services.fleet.journal.tail import Tail
from libmodbus_py.tools.files.amounts import in_bytes, in_seconds
from tests.services.fleet.fleets import simulated_run
from tests.services.fleet.journals import polls, readings
from tests.support.cases import each_case

# --- ids ------------------------------------------------------------------------------------


def test_the_first_id_is_above_all_that_may_have_been_given() -> None:
    assert first_id(1.5, 0) == 1_500_000
    assert first_id(1e9, 7) == 10**15
    # The clock was set back, and the last readings were sent, but never came to the disk.
    assert first_id(0.0, 10**15) == 10**15 + MARGIN
    assert first_id(0.0, 0) == 1


def test_ids_that_no_reading_has_are_not_counted() -> None:
    unused = Unused([(100, 0), (1000, 50), (5000, 1000)])  # 950..999 and 4000..4999
    for after, last, count in (
        (99, 949, 850),
        (99, 999, 850),
        (99, 1000, 851),
        (960, 1000, 1),
        (999, 1009, 10),
        (3998, 4001, 1),
        (3998, 5000, 2),
        (4999, 5009, 10),
        (99, 5000, 850 + 3000 + 1),
        (5009, 5000, 0),
    ):
        assert unused.between(after, last) == count, (after, last)


def test_readings_become_polls_with_ids_in_order() -> None:
    mixed = [*readings("a", 1.0), *readings("b", 1.0), *readings("b", 2.0, 1)]
    found = list(numbered(mixed, 10))
    assert [(each.first, each.last) for each in found] == [(10, 11), (12, 13), (14, 14)]
    assert [one.id for each in found for one in each.readings] == [10, 11, 12, 13, 14]
    assert [one._replace(id=0) for each in found for one in each.readings] == mixed


# --- rows -----------------------------------------------------------------------------------

POINTS = Points(5, 3, ("p0", "p1", "p2"), ("V", "", "W"))


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
    units = dict(zip(POINTS.names, POINTS.units, strict=True))
    whole = [
        Reading(1.25, "a", name, value, units[name], "good", "", 20 + at)
        for at, (name, value) in enumerate(readings)
    ]
    whole[-1] = whole[-1]._replace(quality="bad", reason="Missing")
    [poll] = numbered(whole, 20)
    row = encoded(poll, POINTS)
    assert (row.id, row.readings, row.time, row.device, row.points) == (20, len(whole), 1.25, 3, 5)
    assert decoded(row, "a", POINTS) == poll
    if len(whole) == 3:
        assert row.chosen is None


def test_a_point_that_is_not_in_the_list_is_an_error() -> None:
    [poll] = numbered([Reading(1.0, "a", "p9", 1, "", "good")], 1)
    with pytest.raises(KeyError):
        encoded(poll, POINTS)


def test_values_that_json_lacks_are_none_in_a_row() -> None:
    [poll] = numbered([Reading(1.0, "a", "p1", {"x": float("inf")}, "", "good")], 1)
    assert encoded(poll, POINTS).data == '[{"x":null}]'


# --- memory ---------------------------------------------------------------------------------


def test_the_tail_keeps_the_newest_readings() -> None:
    tail = Tail(6, 9)
    assert tail.after(9, 100) == []
    every = polls(10, 5)
    for each in every:
        tail.add(each)
    assert (tail.before, tail.last) == (13, 19)
    assert tail.after(12, 100) is None
    assert tail.after(13, 100) == every[2:]
    assert tail.after(13, 3) == every[2:3]  # polls are whole
    assert tail.after(13, 1) == every[2:3]  # and there is one at least
    assert tail.after(17, 4) == every[4:]
    assert tail.after(19, 100) == []


def test_the_tail_forgets_what_it_dropped() -> None:
    tail = Tail(4, 0)
    for each in polls(1, 5000):
        tail.add(each)
    assert len(tail._polls) < 1100
    assert sum(len(each.readings) for each in tail._polls) == 4
    assert tail.after(tail.before, 100) == polls(9997, 2, time=5098.0)


# --- places ---------------------------------------------------------------------------------


class Shelf:
    """A journal that has these polls, and no others between them."""

    def __init__(self, *every: JournalPoll) -> None:
        self.polls = list(every)
        self.last = every[-1].last if every else 0
        self.noted = 0
        self.is_stuck = False

    def between(self, after: int, last: int) -> int:
        return last - after

    def note(self) -> asyncio.Future[None]:
        self.noted += 1
        noted = asyncio.get_running_loop().create_future()
        if not self.is_stuck:
            noted.set_result(None)
        return noted

    async def after(self, number: int, most: int) -> tuple[list[JournalPoll], int]:
        behind = [each for each in self.polls if each.first > number]
        return behind[:2], number


def test_an_output_goes_on_where_it_confirmed() -> None:
    async def go() -> None:
        shelf = Shelf(*polls(1, 4))
        place = JournalPlace("x", shelf, 2)
        assert len(place) == 6
        batch = await place.take_polls(1)
        assert [each.id for each in batch] == [3, 4]
        assert len(place) == 6  # taken, but not confirmed
        place.put_back(batch)
        assert await place.take_polls(1) == batch
        await place.confirm(batch)
        assert (place.confirmed, len(place), shelf.noted) == (4, 4, 1)
        assert [each.id for each in await place.take_polls(100)] == [5, 6]
        assert [each.id for each in await place.take_polls(100)] == [7, 8]
        assert await place.take_polls(100, 0.5) == []
        assert place.dropped == 0

    simulated_run(go())


def test_a_place_never_falls() -> None:
    async def go() -> None:
        shelf = Shelf(*polls(1, 4))
        place = JournalPlace("x", shelf, 0)
        first, second = await place.take(2), await place.take(2)
        await place.confirm(second)
        for old in (second, first, []):  # an output that confirms twice, or late
            await place.confirm(old)
            place.drop(old)
        assert (place.confirmed, place.dropped, shelf.noted) == (4, 0, 1)
        place.put_back(first)
        assert [each.id for each in await place.take(2)] == [5, 6]

    simulated_run(go())


def test_a_disk_that_notes_nothing_delays_an_output_by_a_second() -> None:
    async def go() -> None:
        shelf = Shelf(*polls(1, 4))
        shelf.is_stuck = True
        place = JournalPlace("x", shelf, 0)
        loop = asyncio.get_running_loop()
        begun = loop.time()
        await place.confirm(await place.take(2))
        assert loop.time() - begun == pytest.approx(1.0)

    simulated_run(go())


def test_what_was_deleted_unconfirmed_is_counted_and_told_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def go() -> None:
        shelf = Shelf(*polls(1, 10))
        place = JournalPlace("mqtt x", shelf, 0)
        batch = await place.take(2)
        place.put_back(batch)
        for last in (3, 0, 6):
            place.deleted(last)
        assert (place.dropped, place.confirmed, len(place)) == (6, 6, 14)
        assert [each.id for each in await place.take(4)] == [7, 8, 9, 10]
        shelf.polls = shelf.polls[8:]  # rows that were damaged
        assert [each.id for each in await place.take(2)] == [17, 18]
        assert place.dropped == 6 + 6

    simulated_run(go())
    [record] = caplog.records
    assert record.getMessage() == (
        "mqtt x: the journal is full; its oldest readings are dropped unconfirmed"
    )


def test_other_polls_are_looked_at_without_being_taken() -> None:
    async def go() -> None:
        place = JournalPlace("x", Shelf(*polls(1, 8)), 0)
        found = await place.polls(3)
        assert [each[0].id for each in found] == [1, 3, 5]
        assert len(await place.polls(1000)) == 8
        assert [each.id for each in await place.take(3)] == [1, 2, 3, 4]

    simulated_run(go())


def test_a_closed_place_is_over_when_all_was_taken() -> None:
    async def go() -> None:
        place = JournalPlace("x", Shelf(*polls(1, 2)), 0)
        place.close()
        assert not place.is_over
        await place.take(100)
        assert place.is_over
        assert await place.take(100) == []
        other = JournalPlace("x", Shelf(*polls(1, 2)), 0)
        await other.take(2)
        other.give_up()
        assert (other.dropped, len(other)) == (0, 4)  # it waits for the next run

    simulated_run(go())


def test_a_closed_place_ends_the_wait_of_an_output() -> None:
    async def go() -> None:
        place = JournalPlace("x", Shelf(), 0)
        waiting = asyncio.create_task(place.take(100))
        await asyncio.sleep(0)
        assert not waiting.done()
        place.close()
        assert await asyncio.wait_for(waiting, 1) == []

    simulated_run(go())


# --- histories ------------------------------------------------------------------------------


def test_a_thinned_history_keeps_the_smallest_and_the_greatest() -> None:
    values = [HistoricalValue(float(at), at % 100, "good") for at in range(1000)]
    values[555] = HistoricalValue(555.0, None, "down")
    found = thinned(values, 0.0, 1000.0, 30)
    assert len(found) <= 30
    assert [each.time for each in found] == sorted(each.time for each in found)
    assert {0, 99} <= {each.value for each in found}
    assert values[555] in found
    assert thinned(values[:5], 0.0, 1000.0, 3000) == values[:5]
    assert thinned([], 0.0, 0.0, 3) == []


def test_values_that_are_no_numbers_thin_to_one() -> None:
    values = [HistoricalValue(float(at), "on", "good") for at in range(10)]
    assert thinned(values, 0.0, 10.0, 3) == values[:1]
    assert thinned(values, 0.0, 10.0, 10) == values


# --- amounts --------------------------------------------------------------------------------


def test_amounts_have_units() -> None:
    for text, value in (("90 days", 7_776_000), ("1.5h", 5400), ("2 weeks", 1_209_600)):
        assert in_seconds("keep", text, "1 s", "100 years") == value
    for text, value in (("2 GB", 2 * 10**9), ("1 GiB", 1 << 30), ("0.5 MB", 500_000)):
        assert in_bytes("size", text, "1 B", "1 TB") == value


@each_case(
    ("given", "error"),
    [
        (90, TypeError),
        ("90", ValueError),
        ("ninety days", ValueError),
        ("-1 days", ValueError),
        ("1e9 days", ValueError),
        ("90 Days", ValueError),
        ("1 GB", ValueError),
        ("1 s", ValueError),
        ("101 years", ValueError),
        ("9" * 400 + " days", ValueError),
        ("", ValueError),
    ],
)
def test_a_wrong_amount_is_named_with_what_is_allowed(
    given: object, error: type[Exception]
) -> None:
    with pytest.raises(error, match=r'^keep must be a time in "1 minute".."100 years", not '):
        in_seconds("keep", given, "1 minute", "100 years")
