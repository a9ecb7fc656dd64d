"""
Callers who leave, in bytes and times: nothing is told to them, counted or connected for them.
"""

from __future__ import annotations

import errno

import pytest

from libmodbus_py import FrameError, ModbusConnectionError
from libmodbus_py.client.call import NOT_ASKED, Batch
from tests.support.cases import each_case
from tests.support.talk import LINE, TCP, Talk, kinds, rtu, tcp


@each_case("url", [TCP, LINE])
def test_they_are_told_nothing_any_more(url: str) -> None:
    talk = Talk(url, timeout=1)
    batch = talk.batch(1)
    told: list[Batch] = []
    batch.on_done = told.append
    talk.connection.submit(batch, talk.now)
    talk.start()
    talk.cancel(batch)
    talk.wait(3)
    assert batch.is_done
    assert told == []


def test_requests_that_were_not_sent_are_no_sign_of_a_dead_device() -> None:
    talk = Talk(timeout=1, max_in_flight=1)
    talk.ask(1)
    for each in [talk.ask(2), talk.ask(3), talk.ask(4)]:
        talk.cancel(each)
    talk.wait(1)
    batch = talk.ask(5)
    assert talk.connection.broken is None
    talk.come(tcp(talk.sent[-1]))
    assert batch.outcomes == [[5]]


@each_case("url", [TCP, LINE])
def test_nobody_has_a_connection_made_for_their_repetitions(url: str) -> None:
    talk = Talk(url, busy_retries=1)
    batch = talk.ask(1)
    body = "83 06"
    talk.come(tcp(talk.sent[-1], body) if url == TCP else rtu("01 " + body))
    assert talk.connection.is_wanted
    talk.cancel(batch)
    assert talk.is_at_rest


def test_who_only_waits_for_a_connection_is_told_why_there_is_none() -> None:
    talk = Talk(is_open=False)
    joining, left = talk.join(), talk.join()
    talk.connection.withdraw(left, talk.now)
    talk.fail()
    assert isinstance(joining.outcome, ModbusConnectionError)
    assert joining.outcome.errno == 111
    assert left.outcome is NOT_ASKED
    assert talk.is_at_rest


def test_who_is_refused_does_not_wait() -> None:
    talk = Talk()
    talk.connection.closed(ModbusConnectionError("closed", errno=errno.EBADF), talk.now)
    assert talk.ask(1).is_done
    assert talk.is_at_rest
    assert talk.connection.alarm == float("inf")


def test_requests_go_out_before_answers_are_decoded() -> None:
    talk = Talk(max_in_flight=2)
    batches = [talk.ask(1), talk.ask(2), talk.ask(3)]
    talk.connection.take([tcp(talk.sent[0])], talk.now)
    talk.start()
    assert not batches[0].is_done
    assert len(talk.sent) == 3
    talk.connection.take([tcp(talk.sent[1]), tcp(talk.sent[2])], talk.now)
    talk.connection.settle(talk.now)
    assert [each.outcomes for each in batches] == [[[1]], [[2]], [[3]]]


def test_an_answer_of_may_send_that_is_false_is_no_mistake(
    caplog: pytest.LogCaptureFixture,
) -> None:
    for answer in (False, True):
        talk = Talk(may_send=lambda answer=answer: answer)
        batch = talk.ask(1)
        assert batch.is_done is not answer
        assert caplog.records == []
    for mistake in (1, 0, None, "yes"):
        talk = Talk(may_send=lambda mistake=mistake: mistake)
        (outcome,) = talk.ask(1).outcomes
        assert isinstance(outcome, ModbusConnectionError)
        assert outcome.errno == errno.EPERM
        assert caplog.records
        caplog.clear()


def test_a_batch_that_failed_while_it_waited_can_be_left() -> None:
    talk = Talk(max_in_flight=4)
    batch = talk.ask(*range(9), limit=16)
    assert len(talk.sent) == 4
    talk.come(tcp(talk.sent[3], "83 02"))
    talk.come(tcp(talk.sent[0]))
    talk.cancel(batch)
    assert talk.is_at_rest


def test_nothing_is_sent_over_a_connection_that_is_out_of_step() -> None:
    talk = Talk(max_in_flight=1)
    first, second = talk.ask(1), talk.ask(2)
    talk.come(bytes.fromhex("0001 0000 0000"))
    assert kinds(first) == [FrameError]
    assert len(talk.sent) == 1
    talk.leave_broken()
    talk.open()
    talk.come(tcp(talk.sent[-1]))
    assert second.outcomes == [[2]]


def test_only_one_request_of_a_batch_fails_at_once_where_a_line_does_not_fall_silent() -> None:
    """The next one has its own time to wait for silence."""
    talk = Talk(LINE, timeout=1)
    talk.ask(1)
    talk.wait(1)
    batch = talk.ask(2, 3, go_on=True)
    for _ in range(9):
        talk.come(b"\xff")
        talk.wait(0.25)
        if kinds(batch)[0] is FrameError:
            break
    assert kinds(batch) == [FrameError, NOT_ASKED]
    assert len(talk.sent) == 1
