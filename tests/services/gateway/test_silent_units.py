"""
Units that rest, and answers that are given again: with times from a list.
"""

from __future__ import annotations

from libmodbus_py.services.gateway.cache import Cache
from libmodbus_py.services.gateway.silent_units import SilentUnits, UnitState

# --- silent units -----------------------------------------------------------------------------


def test_a_silent_unit_rests_longer_each_time_until_it_answers() -> None:
    units = SilentUnits(0.5)
    assert units.state(7, 3, 0.0) is UnitState.GOOD
    assert units.note_silence(7, 3, 1.0)
    now, pause = 1.0, 0.5
    for _ in range(10):
        assert units.state(7, 3, now + 0.99 * pause) is UnitState.RESTING
        now += pause
        assert units.state(7, 3, now) is UnitState.DUE
        units.start_trial(7, 3)
        assert units.state(7, 3, now) is UnitState.RESTING  # one trial is enough
        assert not units.note_silence(7, 3, now)
        pause = min(2 * pause, 30.0)
    assert units.note_answer(7, 3)
    assert units.state(7, 3, now) is UnitState.GOOD
    assert not units.note_answer(7, 3)
    assert units.state(8, 3, now) is UnitState.GOOD


def test_requests_that_were_in_flight_with_it_do_not_make_it_rest_longer() -> None:
    units = SilentUnits(1.0)
    assert units.note_silence(3, 3, 0.0)
    assert not units.note_silence(3, 3, 0.1)
    assert units.state(3, 3, 1.0) is UnitState.DUE


def test_a_trial_that_was_not_made_leaves_it_due() -> None:
    units = SilentUnits(1.0)
    units.note_silence(3, 3, 0.0)
    units.start_trial(3, 3)
    units.cancel_trial(3, 3, 1.5)
    assert units.state(3, 3, 1.5) is UnitState.DUE


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
