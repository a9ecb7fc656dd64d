"""
Whose request is next, and which units rest: with times from a list.
"""

from __future__ import annotations

from typing import NamedTuple

from libmodbus_py.services.gateway.cache import Cache
from libmodbus_py.services.gateway.silent_units import LONGEST_PAUSE, SilentUnits, Standing
from libmodbus_py.services.gateway.turns import Turns


class Asked(NamedTuple):
    host: str
    client: str
    number: int
    unit: int = 1


def order(turns: Turns[Asked], held: tuple[int, ...] = ()) -> str:
    found = []
    while (each := turns.take(held)) is not None:
        found.append(f"{each.client}{each.number}")
    return " ".join(found)


def filled(*asked: Asked, most_of_client: int = 9, most: int = 99) -> Turns[Asked]:
    turns: Turns[Asked] = Turns(most_of_client, most)
    assert all(turns.put(each) for each in asked)
    return turns


def test_clients_take_turns_and_each_is_answered_in_its_order() -> None:
    eager = [Asked("h", "a", number) for number in range(4)]
    turns = filled(*eager, Asked("h", "b", 0), Asked("h", "c", 0), Asked("h", "b", 1))
    assert order(turns) == "a0 b0 c0 a1 b1 a2 a3"
    assert len(turns) == 0


def test_a_host_with_many_clients_has_no_more_turns_than_another() -> None:
    many = [Asked("h", name, 0) for name in "abcd"]
    assert order(filled(*many, Asked("i", "x", 0), Asked("i", "x", 1))) == "a0 x0 b0 x1 c0 d0"


def test_who_has_had_a_turn_comes_last_when_he_asks_again() -> None:
    turns = filled(Asked("h", "a", 0), Asked("h", "b", 0), Asked("h", "a", 1))
    first = turns.take()
    assert first is not None
    assert first.client == "a"
    assert turns.put(Asked("h", "a", 2))
    assert order(turns) == "b0 a1 a2"


def test_one_client_fills_its_own_queue_only() -> None:
    turns = filled(Asked("h", "a", 0), Asked("h", "a", 1), most_of_client=2, most=3)
    assert not turns.put(Asked("h", "a", 2))
    assert turns.put(Asked("h", "b", 0))
    assert not turns.put(Asked("h", "c", 0))  # as many as may wait in all
    assert order(turns) == "a0 b0 a1"


def test_what_is_held_waits_and_nobody_behind_it() -> None:
    turns = filled(Asked("h", "a", 0, 5), Asked("h", "a", 1), Asked("h", "b", 0, 5))
    assert order(turns, held=(5,)) == "a1"
    assert order(turns) == "b0 a0" or len(turns) == 0


def test_what_is_removed_is_not_given() -> None:
    turns = filled(*(asked := [Asked("h", "a", 0), Asked("h", "a", 1), Asked("i", "b", 0)]))
    turns.remove(asked[1])
    turns.remove(asked[2])
    assert not turns.has(asked[2])
    assert turns.of_unit(1) == asked[:1]
    assert order(turns) == "a0"


# --- silent units -----------------------------------------------------------------------------


def test_a_silent_unit_rests_longer_each_time_until_it_answers() -> None:
    units = SilentUnits(0.5)
    assert units.standing(7, 0.0) is Standing.GOOD
    assert units.note_silence(7, 1.0)
    now, pause = 1.0, 0.5
    for _ in range(10):
        assert units.standing(7, now + 0.99 * pause) is Standing.RESTING
        now += pause
        assert units.standing(7, now) is Standing.DUE
        units.note_trial(7)
        assert units.standing(7, now) is Standing.RESTING  # one trial is enough
        assert not units.note_silence(7, now)
        pause = min(2 * pause, LONGEST_PAUSE)
    assert units.note_answer(7)
    assert units.standing(7, now) is Standing.GOOD
    assert not units.note_answer(7)
    assert units.standing(8, now) is Standing.GOOD


def test_requests_that_were_in_flight_with_it_do_not_make_it_rest_longer() -> None:
    units = SilentUnits(1.0)
    assert units.note_silence(3, 0.0)
    assert not units.note_silence(3, 0.1)
    assert units.standing(3, 1.0) is Standing.DUE


def test_a_trial_that_was_not_made_leaves_it_due() -> None:
    units = SilentUnits(1.0)
    units.note_silence(3, 0.0)
    units.note_trial(3)
    units.note_untried(3, 1.5)
    assert units.standing(3, 1.5) is Standing.DUE


# --- the cache --------------------------------------------------------------------------------


def test_an_answer_is_given_again_while_it_is_fresh() -> None:
    cache = Cache()
    cache.keep(1, b"ask", b"answer", 10.0, cache.state(1))
    assert cache.get(1, b"ask", 0.5, 10.5) == b"answer"
    assert cache.get(1, b"ask", 0.5, 10.6) is None
    assert cache.get(2, b"ask", 0.5, 10.0) is None
    assert cache.get(1, b"other", 0.5, 10.0) is None


def test_a_write_has_answers_forgotten_and_those_that_were_on_their_way() -> None:
    cache = Cache()
    before = cache.state(1)
    cache.keep(1, b"ask", b"old", 10.0, before)
    cache.keep(2, b"ask", b"other", 10.0, cache.state(2))
    cache.forget(1)
    assert cache.get(1, b"ask", 9, 10.0) is None
    cache.keep(1, b"ask", b"old", 10.0, before)
    assert cache.get(1, b"ask", 9, 10.0) is None
    assert cache.get(2, b"ask", 9, 10.0) == b"other"
    state = cache.state(2)
    cache.forget(0)  # a broadcast
    cache.keep(2, b"ask", b"other", 10.0, state)
    assert cache.get(2, b"ask", 9, 10.0) is None


def test_it_does_not_grow_without_bound() -> None:
    cache = Cache()
    for number in range(20_000):
        cache.keep(1, number.to_bytes(4, "big"), b"answer", 0.0, 0)
    assert len(cache._answers) <= 4096
    assert cache.get(1, (19_999).to_bytes(4, "big"), 1, 0.0) == b"answer"
