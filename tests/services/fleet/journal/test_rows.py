"""
Polls as rows of a journal, the ids of readings, and the polls in memory.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.journal import place as recent
from libmodbus_py.services.fleet.journal.place import JournalPlace, RecentPolls
from libmodbus_py.services.fleet.journal.schema import (
    MARGIN,
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


def test_readings_become_polls_with_ids_in_order() -> None:
    mixed = [*readings("a", 1.0), *readings("b", 1.0), *readings("b", 2.0, 1)]
    found = list(numbered(mixed, 10))
    assert [(each.first, each.last) for each in found] == [(10, 11), (12, 13), (14, 14)]
    assert [one.id for each in found for one in each.readings] == [10, 11, 12, 13, 14]
    assert [one._replace(id=0) for each in found for one in each.readings] == mixed


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


def test_a_point_that_is_not_in_the_list_is_an_error() -> None:
    [poll] = numbered([Reading(1.0, "a", "p9", 1, "", "good")], 1)
    with pytest.raises(KeyError):
        encoded(poll, POINTS)


def test_values_that_json_lacks_are_none_in_a_row() -> None:
    [poll] = numbered([Reading(1.0, "a", "p1", {"x": float("inf")}, "", "good")], 1)
    assert encoded(poll, POINTS).data == '[{"x":null}]'


def filled(first: int, count: int) -> RecentPolls:
    made = RecentPolls(first - 1)
    for each in polls(first, count):
        made.add(each)
    return made


def test_polls_are_taken_whole_and_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recent, "MOST_IN_MEMORY", 6)
    made, every = filled(10, 5), polls(10, 5)
    assert (made.before, made.last) == (9, 19)  # the file lacks them all
    assert made.after(9, 100) == every
    assert made.take_unwritten(3) == every[:1]
    assert made.take_unwritten(1) == every[1:2]  # one at least
    made.add(polls(20, 1)[0])
    assert (made.before, made.taken, made.dropped) == (13, 13, 0)
    assert made.after(12, 100) is None
    assert made.after(17, 3) == every[4:]
    assert made.after(21, 100) == []


def test_what_no_disk_takes_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recent, "MOST_IN_MEMORY", 4)
    monkeypatch.setattr(recent, "MOST_WAITING", 8)
    made = filled(1, 3)
    assert made.take_unwritten(4) == polls(1, 2)
    for each in polls(7, 100):
        made.add(each)
    # Those that were taken before are on their way to the disk, and not lost.
    assert (made.last, made.dropped) == (206, 206 - 8 - 4)
    assert made.take_unwritten(1000) == made.after(198, 1000) == polls(199, 4, time=196.0)
    assert made.take_unwritten(1) == []


class Shelf:
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


def place_in(shelf: Shelf, confirmed: int, waiting: int) -> JournalPlace:
    return JournalPlace("x", shelf, confirmed, waiting)


@in_simulated_time
async def test_an_output_goes_on_where_it_confirmed() -> None:
    shelf = Shelf(*polls(1, 4))
    place = place_in(shelf, 2, 6)
    assert len(place) == 6
    batch = await place.take_polls(1)
    assert [each.id for each in batch] == [3, 4]
    assert len(place) == 6  # taken, but not confirmed
    place.put_back(batch)
    assert await place.take_polls(1) == batch
    await place.confirm_readings(batch)
    assert (place.confirmed, len(place), shelf.noted) == (4, 4, 1)
    for ids in ([5, 6], [7, 8], []):
        batch = await place.take_polls(100, 0.5)
        assert [each.id for each in batch] == ids
        await place.confirm_readings(batch)
    assert await place.take_polls(100, 0.5) == []
    assert place.dropped == 0


@in_simulated_time
async def test_a_place_never_falls() -> None:
    shelf = Shelf(*polls(1, 4))
    place = place_in(shelf, 0, 8)
    first, second = await place.take_polls(2), await place.take_polls(2)
    await place.confirm_readings(second)
    for old in (second, first, []):  # an output that confirms twice, or late
        await place.confirm_readings(old)
        place.drop_readings(old)
    assert (place.confirmed, place.dropped, shelf.noted) == (4, 0, 1)
    place.put_back(first)
    assert [each.id for each in await place.take_polls(2)] == [5, 6]


@in_simulated_time
async def test_a_disk_that_notes_nothing_delays_an_output_by_a_second() -> None:
    shelf = Shelf(*polls(1, 4))
    shelf.is_stuck = True
    place = place_in(shelf, 0, 8)
    loop = asyncio.get_running_loop()
    begun = loop.time()
    await place.confirm_readings(await place.take_polls(2))
    assert loop.time() - begun == pytest.approx(1.0)


@in_simulated_time
async def test_what_was_deleted_unconfirmed_is_counted_and_told_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    shelf = Shelf(*polls(1, 10))
    place = place_in(shelf, 0, 20)
    batch = await place.take_polls(2)
    place.put_back(batch)
    for gone in ([(1, 2)], [], [(1, 2), (3, 2), (5, 2)]):
        place.deleted(gone)
    assert (place.dropped, place.confirmed, len(place)) == (6, 6, 14)
    batch = await place.take_polls(4)
    assert [each.id for each in batch] == [7, 8, 9, 10]
    await place.confirm_readings(batch)
    shelf.polls = shelf.polls[8:]  # rows that were damaged
    assert [each.id for each in await place.take_polls(2)] == [17, 18]
    assert place.dropped == 6 + 6
    [record] = caplog.records
    assert record.getMessage() == (
        "x: the journal is full; its oldest readings are dropped unconfirmed"
    )


@in_simulated_time
async def test_other_polls_are_looked_at_without_being_taken() -> None:
    place = place_in(Shelf(*polls(1, 8)), 0, 16)
    found = await place.polls(3)
    assert [each[0].id for each in found] == [1, 3, 5]
    assert len(await place.polls(1000)) == 8
    assert [each.id for each in await place.take_polls(3)] == [1, 2, 3, 4]


@in_simulated_time
async def test_a_closed_place_is_over_when_all_was_taken() -> None:
    place = place_in(Shelf(*polls(1, 2)), 0, 4)
    place.close_buffer()
    assert not place.is_over
    await place.take_polls(100)
    assert place.is_over
    assert await place.take_polls(100) == []
    other = place_in(Shelf(*polls(1, 2)), 0, 4)
    await other.take_polls(2)
    other.give_up()
    assert (other.dropped, len(other)) == (0, 4)  # it waits for the next run


@in_simulated_time
async def test_a_closed_place_ends_the_wait_of_an_output() -> None:
    place = place_in(Shelf(), 0, 0)
    waiting = asyncio.create_task(place.take_polls(100))
    await asyncio.sleep(0)
    assert not waiting.done()
    place.close_buffer()
    assert await asyncio.wait_for(waiting, 1) == []
