"""
Requests to a unit that does not answer, beside those to others: how often it is asked alone.
"""

from __future__ import annotations

from libmodbus_py import ModbusTimeoutError, pdu
from tests.client.test_window import grown
from tests.support.talk import Talk, kinds, tcp


def answer(talk: Talk, since: int) -> None:
    """Answer all requests to unit 1 from the one with this index on."""
    talk.come(*[tcp(each) for each in talk.sent[since:] if each[6] == 1])


def silenced(function: pdu.Request[int] | int = 1) -> Talk:
    """Return a talk in which unit 2 gave no answer alone either."""
    talk = grown()
    since = len(talk.sent)
    one, other = talk.ask(function, unit=2), talk.ask(2)
    answer(talk, since)
    talk.wait(2)
    assert [kinds(one), kinds(other)] == [[ModbusTimeoutError], [[2]]]
    assert len(talk.sent) == since + 3
    return talk


def lost_beside_another(talk: Talk, request: pdu.Request[int] | int, unit: int) -> int:
    """Lose a request beside one to unit 1; return how often it was sent."""
    since = len(talk.sent)
    talk.ask(request, unit=unit), talk.ask(2)
    answer(talk, since)
    talk.wait(1)
    talk.wait(3)
    return len(talk.sent) - since - 1


def test_a_silent_unit_is_asked_alone_once() -> None:
    talk = silenced()
    assert [lost_beside_another(talk, 1, unit=2) for _ in range(10)] == [1] * 10


def test_another_function_of_a_silent_unit_is_asked_alone_once_too() -> None:
    talk = silenced()
    inputs = pdu.ReadInputRegisters(1, 1)
    assert [lost_beside_another(talk, inputs, unit=2) for _ in range(5)] == [2, 1, 1, 1, 1]


def test_a_function_stays_silent_while_its_unit_answers_others() -> None:
    talk = silenced(pdu.ReadInputRegisters(1, 1))
    batch = talk.ask(1, unit=2)
    talk.come(tcp(talk.sent[-1]))
    assert batch.outcomes == [[1]]
    inputs = pdu.ReadInputRegisters(1, 1)
    assert [lost_beside_another(talk, inputs, unit=2) for _ in range(10)] == [1] * 10


def test_what_answers_again_is_asked_alone_again() -> None:
    talk = silenced()
    batch = talk.ask(1, unit=2)
    talk.come(tcp(talk.sent[-1]))
    assert batch.outcomes == [[1]]
    assert 2 in [lost_beside_another(talk, 1, unit=2) for _ in range(3)]


def test_another_connection_knows_of_no_silent_units() -> None:
    talk = silenced()
    talk.lose()
    talk.open()
    talk.ask(*range(7), limit=16)
    while not talk.is_at_rest:
        answer(talk, len(talk.sent) - talk.connection.in_flight)
    assert lost_beside_another(talk, 1, unit=2) == 2
