"""
Units that rest, and functions that a unit leaves without an answer: with times from a list.
"""

from __future__ import annotations

import random

import pytest

from libmodbus_py.services.gateway.silent_units import SilentUnits, UnitState

GOOD, RESTING, DUE = UnitState.GOOD, UnitState.RESTING, UnitState.DUE


def test_a_silent_unit_rests_longer_each_time_until_it_answers() -> None:
    """The function that got no answer twice as long as others, which it may answer."""
    units = SilentUnits(0.5)
    assert units.state(7, 3, 0.0) is GOOD
    assert units.note_silence(7, 3, 1.0)
    now, rest = 1.0, 0.5
    for misses in range(1, 11):
        assert [units.state(7, 4, now + part * rest) for part in (0.99, 1)] == [RESTING, DUE]
        assert [units.state(7, 3, now + part * rest) for part in (1.99, 2)] == [RESTING, DUE]
        now += 2 * rest
        assert units.start_trial(7, 3) == misses
        assert {units.state(7, each, now) for each in (3, 4)} == {RESTING}  # one trial is enough
        assert not units.note_silence(7, 3, now)
        rest = min(2 * rest, 15.0)
    assert units.note_answer(7, 3)
    assert units.state(7, 3, now) is GOOD
    assert not units.note_answer(7, 3)
    assert units.state(8, 3, now) is GOOD
    assert units.note_silence(7, 3, now)  # and it begins anew
    assert units.state(7, 3, now + 1.0) is DUE


def test_requests_that_were_in_flight_with_it_do_not_make_it_rest_longer() -> None:
    units = SilentUnits(1.0)
    assert units.note_silence(3, 3, 0.0)
    assert not units.note_silence(3, 3, 1.0)
    assert units.state(3, 3, 2.0) is DUE


def test_a_unit_rests_when_nothing_that_it_answered_is_answered_any_more() -> None:
    units = SilentUnits(1.0)
    for function in (3, 4):
        units.note_answer(7, function)
    assert units.note_silence(7, 5, -9.0)
    assert units.start_trial(7, 5) == 1
    assert units.note_silence(7, 3, 0.0)
    assert not units.rests(7)
    assert units.note_silence(7, 4, 0.1)
    assert units.rests(7)
    assert not units.note_silence(7, 5, 0.2)  # it was in flight with the other one
    assert units.state(7, 16, 0.5) is RESTING
    # When it is back, so is all that was silent with it.
    assert units.note_answer(7, 16)
    assert not units.rests(7)
    assert {units.state(7, function, 0.5) for function in (3, 4, 5, 16)} == {GOOD}


def test_a_trial_that_was_not_sent_lets_whoever_comes_next_try() -> None:
    units = SilentUnits(1.0)
    units.note_silence(7, 3, 0.0)
    units.start_trial(7, 4)
    units.cancel_trial(7, 4, 1.2)
    assert [units.state(7, function, 1.2) for function in (3, 4)] == [DUE, DUE]
    units.cancel_trial(7, 4, 9.0)  # nothing tries now
    assert units.state(7, 3, 1.3) is DUE


@pytest.mark.parametrize("seed", range(20))
def test_nothing_rests_of_what_was_answered_last_and_nothing_for_ever(seed: int) -> None:
    """Requests are in flight beside each other, and some are dropped."""
    chance = random.Random(seed)
    units, now = SilentUnits(0.5), 0.0
    keys = [(unit, function) for unit in (1, 2) for function in (3, 4, 5)]
    answered: dict[tuple[int, int], bool] = {}
    in_flight: list[tuple[tuple[int, int], bool]] = []
    for turn in range(500):
        now += chance.random()
        key = chance.choice(keys)
        if turn < 450 and (state := units.state(*key, now)) is not RESTING:
            if state is DUE:
                units.start_trial(*key)
            in_flight.append((key, state is DUE))
        elif in_flight:
            key, is_trial = in_flight.pop(chance.randrange(len(in_flight)))
            outcome = chance.choice(["answer", "silence", "dropped"])
            if outcome == "dropped" and is_trial:
                units.cancel_trial(*key, now)
            elif outcome == "answer":
                units.note_answer(*key)
            elif outcome == "silence":
                units.note_silence(*key, now)
            if outcome != "dropped":
                answered[key] = outcome == "answer"
        for each in (each for each, is_good in answered.items() if is_good):
            assert units.state(*each, now) is GOOD
            assert not units.rests(each[0])
    while in_flight:
        units.note_silence(*in_flight.pop()[0], now)
    assert RESTING not in {units.state(*key, now + 30) for key in keys}
