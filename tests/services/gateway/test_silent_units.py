"""
Units that rest, and functions that a unit leaves without an answer: with times from a list.
"""

import random

import pytest

from libmodbus_py.services.gateway.silent_units import SilentUnits, UnitState

GOOD, RESTING, DUE = UnitState.GOOD, UnitState.RESTING, UnitState.DUE


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
