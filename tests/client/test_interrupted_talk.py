"""
Attempts to connect that take too long, and callers who are interrupted, in bytes and times.
"""

from __future__ import annotations

import errno
import math

from libmodbus_py import ModbusConnectionError, pdu
from libmodbus_py.client.reconnecting import State
from tests.support.cases import each_case
from tests.support.talk import LINE, TCP, Talk, kinds, rtu, tcp

LATE = ModbusConnectionError("no connection in time", errno=errno.ETIMEDOUT)
INTERRUPTED = ModbusConnectionError("interrupted", errno=errno.EINTR)


def test_an_attempt_may_take_as_long_as_the_caller_with_most_time_waits() -> None:
    talk = Talk(is_open=False)
    assert talk.connection.connect_until() == 0.0
    for timeout in (1, 3, 2):
        talk.ask(1, timeout=timeout)
    assert talk.connection.connect_until() == 3


@each_case(("until", "is_done"), [(1.0, False), (2.9, False), (3.0, True), (math.inf, True)])
def test_who_has_more_time_than_the_attempt_waits_for_the_next(until: float, is_done: bool) -> None:
    talk = Talk(is_open=False, max_pause=0)
    short, long = talk.ask(1, timeout=1), talk.ask(2, timeout=3)
    talk.life.connecting()
    talk.now = 1.0
    talk.connection.failed(LATE, talk.now, until)
    assert kinds(short) == [ModbusConnectionError]
    assert long.is_done is is_done
    assert talk.connection.is_wanted is not is_done
    if not is_done:
        assert talk.connection.alarm <= 3.0
        talk.wait_until(2.9)
        assert not long.is_done
        talk.wait_until(3.0)
        assert "no connection" in str(long.outcomes[0])
    assert talk.is_at_rest


def test_a_refused_attempt_fails_all_who_wait() -> None:
    talk = Talk(is_open=False, max_pause=0)
    batch = talk.ask(1, timeout=9)
    talk.life.connecting()
    refused = ModbusConnectionError("refused", errno=errno.ECONNREFUSED)
    talk.connection.failed(refused, 0.5, 1.0)
    assert kinds(batch) == [ModbusConnectionError]
    assert batch.outcomes[0].errno == errno.ECONNREFUSED


@each_case("url", [TCP, LINE])
def test_nothing_is_left_of_what_was_interrupted(url: str) -> None:
    talk = Talk(url, timeout=1, busy_retries=1, turnaround=0.5)
    busy = talk.ask(1)
    body = "83 06"
    talk.come(tcp(talk.sent[-1], body) if url == TCP else rtu("01 " + body))
    everyone = talk.ask(pdu.WriteRegister(1, 2), unit=0, is_broadcast=True)
    asked, waiting = talk.ask(2), talk.ask(3)
    sent = len(talk.sent)
    talk.connection.interrupted(INTERRUPTED, talk.now)
    assert talk.is_at_rest
    assert talk.life.state is State.DISCONNECTED
    # On a line, the broadcast waited for the repetition before it.
    assert talk.statistics.results[6, "cancelled"] == (url == TCP)
    talk.open()
    talk.wait(5)
    assert len(talk.sent) == sent
    assert not any(each.is_done for each in (busy, everyone, asked, waiting))
    batch = talk.ask(7)
    talk.come(tcp(talk.sent[-1]) if url == TCP else rtu("01 03 02 0007"))
    assert batch.outcomes == [[7]]


@each_case("url", [TCP, LINE])
def test_a_broadcast_that_was_interrupted_holds_nobody_up(url: str) -> None:
    talk = Talk(url, timeout=1, turnaround=5)
    everyone = talk.ask(pdu.WriteRegister(1, 2), unit=0, is_broadcast=True)
    talk.connection.interrupted(INTERRUPTED, talk.now)
    assert talk.statistics.results[6, "cancelled"] == 1
    assert not everyone.is_done
    talk.open()
    batch = talk.ask(7)
    talk.wait_for(2)
    assert talk.now < 1
    talk.come(tcp(talk.sent[-1]) if url == TCP else rtu("01 03 02 0007"))
    assert batch.outcomes == [[7]]


def test_an_attempt_that_was_interrupted_is_given_up() -> None:
    talk = Talk(is_open=False)
    talk.ask(1)
    talk.life.connecting()
    talk.connection.interrupted(INTERRUPTED, talk.now)
    assert talk.life.state is State.DISCONNECTED
    assert talk.is_at_rest
    talk.open()
    assert talk.sent == []


def test_a_connection_that_was_lost_begins_with_nothing_in_flight() -> None:
    talk = Talk(LINE, turnaround=5)
    everyone = talk.ask(pdu.WriteRegister(1, 2), unit=0, is_broadcast=True)
    talk.lose()
    assert kinds(everyone) == [ModbusConnectionError]
    assert talk.connection.in_flight == 0
    talk.open()
    talk.ask(1)
    talk.wait_for(2)
    assert talk.now < 5
    assert talk.connection.in_flight == 1


def test_another_device_behind_the_address_is_asked_with_one_request_at_first() -> None:
    for by_itself in (True, False):
        talk = Talk(max_in_flight=None)
        talk.ask(*range(7), limit=16)
        while not talk.is_at_rest:
            pending = talk.connection.in_flight
            talk.come(*[tcp(each) for each in talk.sent[len(talk.sent) - pending :]])
        assert talk.connection.room >= 4
        talk.lose(by_itself=by_itself)
        talk.open()
        assert talk.connection.room == 1
