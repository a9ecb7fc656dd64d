"""
The place of an output in a journal: what it takes, confirms, gives back and misses.
"""

from __future__ import annotations

import asyncio
from typing import cast

import pytest

from libmodbus_py.fleet import Journal
from libmodbus_py.services.fleet.journal.place import JournalPlace
from libmodbus_py.services.fleet.journal.schema import JournalPoll
from tests.services.fleet.fleets import simulated_run
from tests.services.fleet.journal.journals import polls


class Shelf:
    """A journal that has these polls, and no others between them."""

    def __init__(self, *every: JournalPoll) -> None:
        self.polls = list(every)
        self.last = every[-1].last if every else 0
        self.noted = 0
        self.is_stuck = False

    def note(self) -> asyncio.Future[None]:
        self.noted += 1
        noted = asyncio.get_running_loop().create_future()
        if not self.is_stuck:
            noted.set_result(None)
        return noted

    async def after(self, number: int, most: int) -> tuple[list[JournalPoll], int]:
        behind = [each for each in self.polls if each.first > number]
        return behind[:2], number


def place_in(shelf: Shelf, confirmed: int, waiting: int) -> JournalPlace:
    return JournalPlace("x", cast(Journal, shelf), confirmed, waiting)


def test_an_output_goes_on_where_it_confirmed() -> None:
    async def go() -> None:
        shelf = Shelf(*polls(1, 4))
        place = place_in(shelf, 2, 6)
        assert len(place) == 6
        batch = await place.take_polls(1)
        assert [each.id for each in batch] == [3, 4]
        assert len(place) == 6  # taken, but not confirmed
        place.put_back(batch)
        assert await place.take_polls(1) == batch
        await place.confirm(batch)
        assert (place.confirmed, len(place), shelf.noted) == (4, 4, 1)
        for ids in ([5, 6], [7, 8], []):
            batch = await place.take_polls(100, 0.5)
            assert [each.id for each in batch] == ids
            await place.confirm(batch)
        assert await place.take_polls(100, 0.5) == []
        assert place.dropped == 0

    simulated_run(go())


def test_a_place_never_falls() -> None:
    async def go() -> None:
        shelf = Shelf(*polls(1, 4))
        place = place_in(shelf, 0, 8)
        first, second = await place.take_polls(2), await place.take_polls(2)
        await place.confirm(second)
        for old in (second, first, []):  # an output that confirms twice, or late
            await place.confirm(old)
            place.drop(old)
        assert (place.confirmed, place.dropped, shelf.noted) == (4, 0, 1)
        place.put_back(first)
        assert [each.id for each in await place.take_polls(2)] == [5, 6]

    simulated_run(go())


def test_a_disk_that_notes_nothing_delays_an_output_by_a_second() -> None:
    async def go() -> None:
        shelf = Shelf(*polls(1, 4))
        shelf.is_stuck = True
        place = place_in(shelf, 0, 8)
        loop = asyncio.get_running_loop()
        begun = loop.time()
        await place.confirm(await place.take_polls(2))
        assert loop.time() - begun == pytest.approx(1.0)

    simulated_run(go())


def test_what_was_deleted_unconfirmed_is_counted_and_told_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def go() -> None:
        shelf = Shelf(*polls(1, 10))
        place = place_in(shelf, 0, 20)
        batch = await place.take_polls(2)
        place.put_back(batch)
        for gone in ([(1, 2)], [], [(1, 2), (3, 2), (5, 2)]):
            place.deleted(gone)
        assert (place.dropped, place.confirmed, len(place)) == (6, 6, 14)
        batch = await place.take_polls(4)
        assert [each.id for each in batch] == [7, 8, 9, 10]
        await place.confirm(batch)
        shelf.polls = shelf.polls[8:]  # rows that were damaged
        assert [each.id for each in await place.take_polls(2)] == [17, 18]
        assert place.dropped == 6 + 6

    simulated_run(go())
    [record] = caplog.records
    assert record.getMessage() == (
        "x: the journal is full; its oldest readings are dropped unconfirmed"
    )


def test_other_polls_are_looked_at_without_being_taken() -> None:
    async def go() -> None:
        place = place_in(Shelf(*polls(1, 8)), 0, 16)
        found = await place.polls(3)
        assert [each[0].id for each in found] == [1, 3, 5]
        assert len(await place.polls(1000)) == 8
        assert [each.id for each in await place.take_polls(3)] == [1, 2, 3, 4]

    simulated_run(go())


def test_a_closed_place_is_over_when_all_was_taken() -> None:
    async def go() -> None:
        place = place_in(Shelf(*polls(1, 2)), 0, 4)
        place.close()
        assert not place.is_over
        await place.take_polls(100)
        assert place.is_over
        assert await place.take_polls(100) == []
        other = place_in(Shelf(*polls(1, 2)), 0, 4)
        await other.take_polls(2)
        other.give_up()
        assert (other.dropped, len(other)) == (0, 4)  # it waits for the next run

    simulated_run(go())


def test_a_closed_place_ends_the_wait_of_an_output() -> None:
    async def go() -> None:
        place = place_in(Shelf(), 0, 0)
        waiting = asyncio.create_task(place.take_polls(100))
        await asyncio.sleep(0)
        assert not waiting.done()
        place.close()
        assert await asyncio.wait_for(waiting, 1) == []

    simulated_run(go())
