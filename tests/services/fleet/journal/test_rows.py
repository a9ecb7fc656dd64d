"""
Polls as rows of a journal, the ids of readings, and the polls in memory.
"""

import asyncio
from collections.abc import Sequence

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.journal.place import JournalPlace
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
from tests.services.fleet.journal.journals import polls
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
    return JournalPlace("x", shelf, confirmed, waiting)


@in_simulated_time
async def test_a_place_never_falls() -> None:
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


@in_simulated_time
async def test_a_disk_that_notes_nothing_delays_an_output_by_a_second() -> None:
    shelf = Shelf(*polls(1, 4))
    shelf.is_stuck = True
    place = place_in(shelf, 0, 8)
    loop = asyncio.get_running_loop()
    begun = loop.time()
    await place.confirm(await place.take_polls(2))
    assert loop.time() - begun == pytest.approx(1.0)
