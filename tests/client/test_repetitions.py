"""
Requests that are sent again, in bytes and times: when, and what becomes of those beside them.
"""

from __future__ import annotations

from libmodbus_py import FrameError, ModbusConnectionError, ModbusTimeoutError
from tests.support.talk import LINE, TCP, Talk, kinds, rtu, tcp, value


def test_all_that_are_due_leave_together() -> None:
    talk = Talk(busy_retries=1)
    batches = [talk.ask(number) for number in range(3)]
    talk.come(*[tcp(each, "83 06") for each in talk.sent])
    talk.now = 0.1
    talk.conversation.tick(talk.now)
    assert len(talk.conversation.start(talk.now)) == 3
    assert not any(batch.is_done for batch in batches)


def test_they_are_spaced_as_all_requests_are() -> None:
    talk = Talk(busy_retries=1, request_spacing=0.25)
    for number in range(3):
        talk.ask(number)
    talk.wait(0.5)
    talk.come(*[tcp(each, "83 06") for each in talk.sent])
    talk.wait(2)
    assert [round(at, 3) for at in talk.times] == [0, 0.25, 0.5, 0.75, 1.0, 1.25]


def test_one_that_cannot_be_sent_again_leaves_the_line_to_the_next_of_its_batch() -> None:
    talk = Talk(LINE, timeout=1, retries=1)
    batch = talk.ask(1, 2, go_on=True)
    talk.wait(1)
    while kinds(batch)[0] is not FrameError:
        talk.come(b"\xff")
        talk.wait(0.25)
        assert talk.now < 9
    talk.wait_for(2)
    talk.come(value(2))
    assert kinds(batch) == [FrameError, [2]]
    assert talk.is_at_rest


def test_what_was_lost_beside_others_is_counted_as_sent_again() -> None:
    talk = Talk(max_in_flight=None, timeout=1)
    talk.ask(*range(7), limit=16)
    while not talk.is_at_rest:
        pending = talk.conversation.in_flight
        talk.come(*[tcp(each) for each in talk.sent[len(talk.sent) - pending :]])
    sent = len(talk.sent)
    batches = [talk.ask(1), talk.ask(2), talk.ask(3)]
    room = talk.conversation.room
    assert room >= 3
    talk.wait(1)  # the first of them is asked alone
    assert (len(talk.sent), talk.statistics.retries) == (sent + 4, 1)
    assert talk.conversation.room == 0
    talk.come(tcp(talk.sent[-1]))
    while not talk.is_at_rest:
        talk.come(tcp(talk.sent[-1]))
    assert [each.outcomes for each in batches] == [[[1]], [[2]], [[3]]]
    assert (len(talk.sent), talk.statistics.retries) == (sent + 6, 3)
    assert 0 < talk.conversation.room < room


def test_what_nobody_answers_alone_either_is_not_sent_again() -> None:
    talk = Talk(max_in_flight=None, timeout=1, timeouts_before_reconnect=99)
    talk.ask(*range(7), limit=16)
    while not talk.is_at_rest:
        pending = talk.conversation.in_flight
        talk.come(*[tcp(each) for each in talk.sent[len(talk.sent) - pending :]])
    sent, limit = len(talk.sent), talk.conversation.limit
    batch = talk.ask(*range(limit + 3), limit=16, go_on=True)
    assert len(talk.sent) == sent + limit
    talk.wait(1.3)
    assert kinds(batch)[:limit] == [ModbusTimeoutError] * limit
    talk.wait(9)
    assert batch.is_done
    assert len(talk.sent) == sent + limit + 3 + talk.statistics.retries
    # Each of the first ones once, and one of them alone.
    first = [each[8:10] for each in talk.sent[sent:] if each[9] < limit]
    assert len(first) == limit + 1


def test_what_waits_behind_a_repetition_fails_with_it_when_no_connection_is_made() -> None:
    for url in (LINE, TCP):
        talk = Talk(url, timeout=1, retries=3)
        batch = talk.ask(1, 2, 3, go_on=True)
        talk.wait(1.5)
        talk.lose()
        talk.fail()
        assert kinds(batch) == [ModbusConnectionError] * 3
        assert batch.is_done


def test_a_repetition_is_not_sent_once_its_caller_has_left() -> None:
    for url, busy in ((LINE, rtu("01 83 06")), (TCP, None)):
        talk = Talk(url, timeout=1, busy_retries=3)
        batch = talk.ask(1)
        talk.come(busy or tcp(talk.sent[0], "83 06"))
        assert not batch.is_done
        talk.cancel(batch)
        talk.wait(10)
        assert len(talk.sent) == 1
        assert talk.is_at_rest
