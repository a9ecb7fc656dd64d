"""
Who may ask next on a connection, with times from a list.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import pytest

from libmodbus_py.services import waiting_room
from libmodbus_py.services.waiting_room import FairByHost, FirstCome, WaitingRoom, rest_after


class Asked(NamedTuple):
    host: str
    client: str
    number: int
    unit: int = 1


def order(queue: FairByHost[Asked], held: tuple[int, ...] = ()) -> str:
    found = []
    while (each := queue.pick(lambda each: each.unit not in held)) is not None:
        found.append(f"{each.client}{each.number}")
    return " ".join(found)


def filled(*asked: Asked, most_of_client: int = 9, most: int = 99) -> FairByHost[Asked]:
    queue: FairByHost[Asked] = FairByHost(most_of_client, most)
    assert all(queue.put(each) for each in asked)
    return queue


def test_clients_take_queue_and_each_is_answered_in_its_order() -> None:
    eager = [Asked("h", "a", number) for number in range(4)]
    queue = filled(*eager, Asked("h", "b", 0), Asked("h", "c", 0), Asked("h", "b", 1))
    assert order(queue) == "a0 b0 c0 a1 b1 a2 a3"
    assert not queue.waiting


def test_a_host_with_many_clients_has_no_more_queue_than_another() -> None:
    many = [Asked("h", name, 0) for name in "abcd"]
    assert order(filled(*many, Asked("i", "x", 0), Asked("i", "x", 1))) == "a0 x0 b0 x1 c0 d0"


def test_who_has_had_a_turn_comes_last_when_he_asks_again() -> None:
    queue = filled(Asked("h", "a", 0), Asked("h", "b", 0), Asked("h", "a", 1))
    first = queue.pick()
    assert first is not None
    assert first.client == "a"
    assert queue.put(Asked("h", "a", 2))
    assert order(queue) == "b0 a1 a2"


def test_one_client_fills_its_own_queue_only() -> None:
    queue = filled(Asked("h", "a", 0), Asked("h", "a", 1), most_of_client=2, most=3)
    assert not queue.put(Asked("h", "a", 2))
    assert queue.put(Asked("h", "b", 0))
    assert not queue.put(Asked("h", "c", 0))  # as many as may wait in all
    assert order(queue) == "a0 b0 a1"


def test_what_is_held_waits_and_nobody_behind_it() -> None:
    queue = filled(Asked("h", "a", 0, 5), Asked("h", "a", 1), Asked("h", "b", 0, 5))
    assert order(queue, held=(5,)) == "a1"
    assert order(queue) == "b0 a0" or not queue.waiting


def test_what_is_removed_is_not_given() -> None:
    queue = filled(*(asked := [Asked("h", "a", 0), Asked("h", "a", 1), Asked("i", "b", 0)]))
    queue.remove(asked[1])
    queue.remove(asked[2])
    assert not queue.has(asked[2])
    assert list(queue) == asked[:1]
    assert order(queue) == "a0"


# --- silent units -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("misses", "first", "rest"),
    [
        *((1, 1.0, 1.0), (2, 1.0, 2.0), (4, 1.0, 8.0), (9, 1.0, 60.0)),
        *((10**9, 1.0, 60.0), (1, 300.0, 300.0), (5, 300.0, 300.0)),
    ],
)
def test_rests_double_up_to_the_longest(misses: int, first: float, rest: float) -> None:
    assert rest_after(misses, first, 60.0) == rest


@dataclass(eq=False)
class Request:
    unit: int = 1
    is_trial: bool = False
    misses: int = 1
    waits_since: float = 0.0
    asked_at: float = 0.0


TIMEOUT = 1.0


Room = WaitingRoom[Request]


def room(*waiting: Request, owing: dict[int, float] | None = None, limit: int = 1) -> Room:
    ready_at = None if owing is None else lambda each: owing.get(each.unit, 0.0)
    made: Room = WaitingRoom(lambda: limit, FirstCome(), lambda _: TIMEOUT, ready_at)
    assert all(made.put(each) for each in waiting)
    return made


def start(made: Room, now: float) -> Request:
    each = made.pick(now)
    assert each is not None
    each.asked_at = now
    made.start(each)
    return each


def test_no_more_are_in_flight_than_may_be() -> None:
    made = room(Request(), Request(), Request(), limit=2)
    first = start(made, 0.0)
    start(made, 0.0)
    assert made.pick(0.0) is None
    made.end(first)
    assert made.pick(0.0) is not None


def test_a_silent_unit_is_tried_when_no_one_else_waits() -> None:
    trial, other = Request(9, is_trial=True), Request()
    made = room(trial, other)
    assert start(made, 0.5) is other
    made.end(other, 0.1)
    assert start(made, 0.6) is trial


def test_or_after_a_timeout_but_not_twice_in_a_row() -> None:
    trials = [Request(9, is_trial=True), Request(8, is_trial=True)]
    made = room(*trials, Request(), Request())
    for expected in (trials[0], None, trials[1]):
        picked = start(made, TIMEOUT)
        assert picked is expected or (expected is None and not picked.is_trial)
        made.end(picked)


def test_a_trial_makes_way_after_the_longest_of_the_others_answers() -> None:
    made = room(Request())
    made.end(start(made, 0.0), took=0.2)
    trial = Request(9, is_trial=True)
    made.put(trial)
    assert start(made, 1.0) is trial
    assert made.overstayed(1.9) is None  # no one waits
    made.put(Request())
    assert made.overstayed(1.1) is None
    assert made.alarm == 1.2
    assert made.overstayed(1.2) is trial


def test_a_unit_that_was_slower_has_as_long_as_its_own_answers_took() -> None:
    made = room(Request(9))
    made.end(start(made, 0.0), took=0.4)
    for _ in range(100):  # all others are fast, and what was slow is long ago
        made.put(Request())
        made.end(start(made, 1.0), took=0.01)
    trial = Request(9, is_trial=True)
    made.put(trial)
    start(made, 2.0)
    made.put(Request())
    assert made.overstayed(2.39) is None
    assert made.overstayed(2.4) is trial


def test_one_trial_in_sixteen_waits_to_the_end() -> None:
    found = []
    for misses in range(1, 34):
        made = room(Request(9, is_trial=True, misses=misses))
        start(made, 0.0)
        made.put(Request())
        if made.overstayed(TIMEOUT) is None:
            found.append(misses)
    assert found == [16, 32]
    assert waiting_room.TRIALS_BEFORE_LONG == 16
    assert 0 < waiting_room.SHORTEST_TRIAL < TIMEOUT


def test_a_unit_that_owes_an_answer_is_not_asked_and_others_are() -> None:
    owes, other = Request(5), Request(6)
    made = room(owes, other, owing={5: 3.0})
    assert start(made, 1.0) is other
    made.end(other)
    assert made.pick(2.0) is None
    assert made.alarm == 3.0
    assert made.pick(3.0) is owes
    assert made.alarm == math.inf


def test_what_is_removed_is_not_picked() -> None:
    requests = [Request(), Request(is_trial=True), Request()]
    made = room(*requests)
    assert [made.remove(each) for each in requests[:2]] == [True, True]
    assert not made.remove(requests[0])
    assert made.clear() == requests[2:]
    assert made.pick(9.0) is None
