"""
When to connect again, told in times.
"""

from itertools import pairwise
from typing import Any

from libmodbus_py import ModbusConnectionError
from libmodbus_py.client.reconnecting import Notices, Reconnecting, State
from libmodbus_py.client.statistics import Statistics

REFUSED = ModbusConnectionError("refused", errno=111)


def made(max_pause: float = 30.0, **options: Any) -> Reconnecting:
    notices = options.get("notices", Notices())
    place = "192.0.2.1:502"
    return Reconnecting(place, max_pause, Statistics(), notices, options.get("on_state"))


def fail(connection: Reconnecting, now: float) -> float:
    """An attempt; gives the pause after it."""
    connection.connecting()
    connection.failed(REFUSED, now)
    return connection.next_attempt - now


def test_pauses_double_up_to_the_longest_and_vary_by_a_fifth() -> None:
    connection = made(max_pause=5)
    pauses = [fail(connection, 10.0 * number) for number in range(10)]
    for pause, longest in zip(pauses, [0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5, 5, 5, 5], strict=True):
        assert 0.8 * longest <= pause <= longest + 1e-9
    assert len({round(pause, 6) for pause in pauses[6:]}) > 1


def test_pauses_do_not_overflow() -> None:
    connection = made(max_pause=86_400)
    pauses = [fail(connection, 0.0) for _ in range(2000)]
    assert all(earlier <= later / 0.79 for earlier, later in pairwise(pauses))
    assert max(pauses) <= 86_400


def test_who_cannot_wait_for_the_next_attempt_is_refused_with_the_reason() -> None:
    connection = made()
    assert connection.refusal(0, 1) is None
    for _ in range(5):
        fail(connection, 100)
    assert connection.refusal(100, 103) is None
    refusal = connection.refusal(100, 101)
    assert refusal is not None
    assert refusal.errno == 111
    assert str(refusal).startswith("refused; next attempt in 1.")
    connection.connecting()
    assert connection.refusal(100, 101) is None  # it may come in time


def test_an_answer_ends_the_pauses() -> None:
    connection = made()
    for _ in range(5):
        fail(connection, 0)
    connection.connecting()
    connection.opened()
    connection.prove()
    connection.lost(REFUSED, 50, by_itself=True)
    assert connection.next_attempt <= 50
    assert fail(connection, 60) <= 0.1 + 1e-9


def test_a_connection_that_ends_before_an_answer_has_a_pause_behind_it() -> None:
    connection = made()
    connection.connecting()
    connection.opened()
    connection.lost(REFUSED, 50, by_itself=True)
    assert 0.08 <= connection.next_attempt - 50 <= 0.1 + 1e-9
    connection.connecting()
    connection.opened()
    connection.lost(REFUSED, 60, by_itself=False)  # given up here, and made anew at once
    assert connection.next_attempt < 60


def test_states_are_told_with_their_reasons_and_closed_is_the_last() -> None:
    told: list[tuple[State, Any]] = []
    notices = Notices()
    connection = made(on_state=lambda state, error: told.append((state, error)), notices=notices)
    connection.connecting()
    connection.opened()
    assert connection.is_open
    connection.lost(REFUSED, 0, by_itself=True)
    assert not connection.is_open
    fail(connection, 0)
    connection.close()
    connection.close()
    connection.opened()
    assert told == []
    notices.give()
    assert told == [
        (State.CONNECTING, None),
        (State.CONNECTED, None),
        (State.DISCONNECTED, REFUSED),
        (State.CONNECTING, None),
        (State.DISCONNECTED, REFUSED),
        (State.CLOSED, None),
    ]
    refusal = connection.refusal(0, 1e9)
    assert refusal is not None
    assert "closed" in str(refusal)
