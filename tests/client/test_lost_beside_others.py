"""
Reads that are lost beside others are asked again alone, in bytes and times; writes are not.
"""

from __future__ import annotations

from typing import Any

import pytest

from libmodbus_py import ModbusConnectionError, ModbusTimeoutError, ServerDeviceBusy, pdu
from tests.support.cases import each_case
from tests.support.replies import addresses, answer, answer_all, exchange, refusal, unanswered
from tests.support.talk import Talk, kinds, tcp


def grow(talk: Talk) -> None:
    """Answer seven requests at once each, so that several may be in flight."""
    talk.ask(*range(7), limit=16)
    while not talk.is_at_rest:
        pending = talk.connection.in_flight
        talk.come(*[tcp(each) for each in talk.sent[len(talk.sent) - pending :]])
    assert talk.connection.room >= 4
    talk.forget()


def grown(timeout: float = 1, **options: Any) -> Talk:
    """Return a talk that may have several requests in flight; all answers took no time."""
    talk = Talk(max_in_flight=None, timeout=timeout, **options)
    grow(talk)
    return talk


def test_the_number_doubles_when_all_of_as_many_were_answered() -> None:
    talk = Talk(max_in_flight=None)
    talk.ask(*range(100), limit=99)
    rounds = []
    while not talk.is_at_rest:
        pending = talk.connection.in_flight
        rounds.append(pending)
        last = talk.sent[len(talk.sent) - pending :]
        talk.connection.take([tcp(each) for each in last], talk.now)
        talk.connection.settle(talk.now)
        talk.start()
    assert rounds[:6] == [1, 2, 4, 8, 16, 16]


def test_the_number_does_not_grow_where_nobody_asks_more() -> None:
    talk = Talk(max_in_flight=None)
    for address in range(50):
        talk.ask(address)
        talk.come(answer(talk))
    assert talk.connection.room == 2


def test_a_read_is_lost_after_a_quarter_of_its_timeout() -> None:
    talk = grown(timeout=4)
    one, other = talk.ask(1), talk.ask(2)
    talk.come(answer(talk))
    talk.wait(0.99)
    assert addresses(talk) == [1, 2]
    talk.wait(0.01)
    assert addresses(talk) == [1, 2, 1]
    talk.come(answer(talk))
    assert (one.outcomes, other.outcomes) == ([[1]], [[2]])
    assert talk.connection.room == talk.statistics.falls == 1


def test_a_read_is_not_lost_before_twice_the_time_of_the_slowest_answer() -> None:
    talk = grown(timeout=4)
    exchange(talk, 1, after=1.5)
    talk.ask(1), talk.ask(2)
    talk.come(answer(talk))
    talk.wait(2.99)
    assert addresses(talk) == [1, 1, 2]
    talk.wait(0.01)
    assert addresses(talk) == [1, 1, 2, 1]


def test_nothing_is_sent_beside_the_repetition_nor_before_it() -> None:
    talk = grown(timeout=4)
    one, other = talk.ask(1), talk.ask(2)
    talk.wait(0.5)
    third = talk.ask(3)
    talk.wait(0.5)  # the first two are lost; the third is in flight
    fourth = talk.ask(4)
    assert talk.connection.room == 0
    for sent in ([1, 2, 3], [1, 2, 3, 1], [1, 2, 3, 1, 2], [1, 2, 3, 1, 2, 4]):
        assert addresses(talk) == sent
        talk.come(answer(talk))
    assert [each.outcomes for each in (one, other, third, fourth)] == [[[1]], [[2]], [[3]], [[4]]]
    assert talk.is_at_rest


@each_case("is_late", [True, False])
def test_a_device_that_was_only_late_loses_nothing(is_late: bool) -> None:
    """Only if the first one stays without an answer, the device takes one at a time."""
    talk = grown()
    one, other = talk.ask(1), talk.ask(2)
    talk.come(answer(talk))
    talk.wait(1)
    if is_late:
        talk.come(answer(talk, 0))
        assert not one.is_done
    talk.come(answer(talk))
    assert (one.outcomes, other.outcomes) == ([[1]], [[2]])
    assert talk.statistics.falls == (not is_late)
    assert talk.statistics.late_answers == is_late
    exchange(talk, 9)
    assert talk.is_at_rest


def test_a_repetition_has_its_own_time() -> None:
    talk = grown()
    one, other = talk.ask(1), talk.ask(2)
    talk.come(answer(talk))
    talk.wait(1.2)
    assert (one.is_done, other.is_done) == (False, True)
    talk.wait(0.1)
    assert kinds(one) == [ModbusTimeoutError]
    assert talk.statistics.falls == 0
    assert talk.connection.room >= 4


def test_one_that_was_alone_is_not_sent_again() -> None:
    talk = grown()
    unanswered(talk)
    talk.wait(1)
    assert len(talk.sent) == 1


def test_busy_alone_is_the_answer() -> None:
    talk = grown()
    one, other = talk.ask(1), talk.ask(2)
    talk.come(refusal(talk, 6, 0), answer(talk, 1))
    talk.come(refusal(talk, 6))
    assert (kinds(one), other.outcomes) == ([ServerDeviceBusy], [[2]])


@pytest.mark.parametrize("when", ["before the repetition", "in the repetition"])
def test_a_caller_who_leaves_holds_nobody_up(when: str) -> None:
    talk = grown()
    one, other = talk.ask(1), talk.ask(2)
    if when == "before the repetition":
        talk.wait(0.1)
        third = talk.ask(3)  # in flight while the two are lost
        talk.wait(0.2)
        talk.cancel(one)
        talk.come(answer(talk))
        assert third.outcomes == [[3]]
    else:
        talk.wait(1)
        talk.cancel(one)
    talk.come(answer(talk))
    assert other.outcomes == [[2]]
    assert talk.is_at_rest


@pytest.mark.parametrize("end", ["lost", "closed", "refused"])
def test_what_was_lost_ends_with_the_connection(end: str) -> None:
    allowed = [True]
    talk = grown(may_send=lambda: allowed[-1])
    batches = [talk.ask(1), talk.ask(2), talk.ask(3)]
    talk.wait(1)  # one of them is asked alone
    assert talk.connection.room == 0
    error = ModbusConnectionError("the end")
    if end == "lost":
        talk.lose(error)
    elif end == "closed":
        talk.connection.closed(talk.now)
    else:
        allowed.append(False)
        talk.start()
        talk.wait(1)
        allowed.append(True)
    assert all(batch.is_done for batch in batches)
    assert talk.is_at_rest
    if end != "closed":
        talk.reconnect()
        exchange(talk, 9)


def test_what_was_lost_beside_others_is_counted_as_sent_again() -> None:
    talk = grown()
    batches = [talk.ask(1), talk.ask(2), talk.ask(3)]
    assert len(talk.sent) == 3
    talk.wait(1)  # the first of them is asked alone
    assert (len(talk.sent), talk.statistics.retries) == (4, 1)
    answer_all(talk)
    assert [each.outcomes for each in batches] == [[[1]], [[2]], [[3]]]
    assert (len(talk.sent), talk.statistics.retries) == (6, 3)
    assert talk.statistics.timeouts == 0


def test_what_nobody_answers_alone_either_is_not_sent_again() -> None:
    talk = grown(timeouts_before_reconnect=99)
    limit = talk.connection.room
    batch = talk.ask(*range(limit + 3), limit=16, go_on=True)
    assert len(talk.sent) == limit
    talk.wait(9)
    assert kinds(batch) == [ModbusTimeoutError] * (limit + 3)
    # Each of them once, and one of them alone.
    assert len(talk.sent) == limit + 3 + 1
    assert talk.statistics.retries == 1


def test_another_device_behind_the_address_is_asked_with_one_request_at_first() -> None:
    for by_itself in (True, False):
        talk = grown()
        talk.reconnect(by_itself=by_itself)
        assert talk.connection.room == 1


def test_a_write_waits_for_the_reads_before_it_that_are_asked_again() -> None:
    talk = grown()
    reads = [talk.ask(1), talk.ask(2)]
    write, behind = talk.ask(pdu.WriteRegister(5, 6)), talk.ask(3)
    talk.wait(1)
    while not talk.is_at_rest:
        talk.come(tcp(talk.sent[-1], "06 0005 0006" if talk.sent[-1][7] == 6 else None))
    assert [adu[7:10] for adu in talk.sent[2:]] == [
        b"\x03\0\x01", b"\x03\0\x02", b"\x06\0\x05", b"\x03\0\x03",
    ]  # fmt: skip
    assert [kinds(each) for each in (*reads, write, behind)] == [[[1]], [[2]], [None], [[3]]]


def test_reads_that_are_lost_are_asked_again_before_the_connection_counts_as_dead() -> None:
    talk = grown(timeouts_before_reconnect=1)
    batches = [talk.ask(1), talk.ask(2)]
    talk.wait(1)
    assert talk.connection.broken is None
    answer_all(talk)
    assert [each.outcomes for each in batches] == [[[1]], [[2]]]


@pytest.mark.parametrize("copies", [1, 2])
def test_a_late_answer_that_comes_twice_is_the_answer_to_nothing_else(copies: int) -> None:
    talk = grown()
    batches = [talk.ask(1), talk.ask(2)]
    talk.wait(1)
    talk.come(*[tcp(talk.sent[0], "03 02 0063")] * copies)
    assert not any(each.is_done for each in batches)
    answer_all(talk)
    assert [each.outcomes for each in batches] == [[[1]], [[2]]]
    assert talk.statistics.late_answers == copies


def test_a_read_that_is_not_to_be_sent_again_keeps_its_whole_time() -> None:
    """As where a gateway's client has left: its answer may still come."""
    talk = grown()
    batches = [talk.ask(1), talk.ask(2)]
    batches[0].calls[0].is_wanted = False
    talk.wait(0.99)
    assert not any(each.is_done for each in batches)
    talk.wait(0.01)
    assert kinds(batches[0]) == [ModbusTimeoutError]
    talk.come(answer(talk))  # the second one, alone
    assert batches[1].outcomes == [[2]]


# --- which requests --------------------------------------------------------------------------

READS = [
    pdu.ReadCoils(0, 1),
    pdu.ReadDiscreteInputs(0, 1),
    pdu.ReadHoldingRegisters(0, 1),
    pdu.ReadInputRegisters(0, 1),
    pdu.ReadExceptionStatus(),
    pdu.ReadCommEventCounter(),
    pdu.ReadCommEventLog(),
    pdu.ReportServerId(),
    pdu.ReadFileRecords(((4, 1, 2),)),
    pdu.ReadFifoQueue(0),
    pdu.ReadDeviceIdentification(1),
]


WRITES = [
    pdu.WriteCoil(0, True),
    pdu.WriteRegister(0, 1),
    pdu.Diagnostics(10, b"\0\0"),
    pdu.WriteCoils(0, (True,)),
    pdu.WriteRegisters(0, (1,)),
    pdu.WriteFileRecords(((4, 1, (2,)),)),
    pdu.MaskWriteRegister(0, 0, 1),
    pdu.ReadWriteRegisters(0, 1, 0, (1,)),
]


@each_case("request", READS, ids=repr)
def test_a_read_is_asked_again_alone(request: Any) -> None:
    talk = grown()
    talk.ask(request), talk.ask(1)
    assert len(talk.sent) == 2
    talk.come(answer(talk))
    talk.wait(1)
    assert [adu[2:] for adu in talk.sent[2:]] == [talk.sent[0][2:]]


@each_case("request", WRITES, ids=repr)
def test_a_write_is_sent_beside_no_other_and_once(request: Any) -> None:
    talk = grown()
    batch = talk.ask(request)
    other = talk.ask(1)
    talk.wait(0.99)
    assert len(talk.sent) == 1
    talk.wait(0.01)
    assert isinstance(batch.outcomes[0], ModbusTimeoutError)
    assert len(talk.sent) == 2
    talk.come(answer(talk))
    assert other.outcomes == [[1]]
    assert talk.statistics.retries == 0
    assert talk.is_at_rest


# --- units that do not answer ----------------------------------------------------------------


def silenced(function: pdu.Request[int] | int = 1) -> Talk:
    """Return a talk in which unit 2 gave no answer alone either."""
    talk = grown()
    one, other = talk.ask(function, unit=2), talk.ask(2)
    talk.come(answer(talk))
    talk.wait(2)
    assert [kinds(one), kinds(other)] == [[ModbusTimeoutError], [[2]]]
    assert len(talk.sent) == 3
    return talk


def lost_beside_another(talk: Talk, request: pdu.Request[int] | int = 1) -> int:
    """Lose a request to unit 2 beside one to unit 1; return how often it was sent."""
    talk.forget()
    talk.ask(request, unit=2), talk.ask(2)
    talk.come(*[tcp(each) for each in talk.sent if each[6] == 1])
    talk.wait(1)
    talk.wait(3)
    return len(talk.sent) - 1


INPUTS = pdu.ReadInputRegisters(1, 1)


def test_a_silent_unit_is_asked_alone_once() -> None:
    talk = silenced()
    assert [lost_beside_another(talk) for _ in range(10)] == [1] * 10


def test_another_function_of_a_silent_unit_is_asked_alone_once_too() -> None:
    talk = silenced()
    assert [lost_beside_another(talk, INPUTS) for _ in range(5)] == [2, 1, 1, 1, 1]


def test_a_function_stays_silent_while_its_unit_answers_others() -> None:
    talk = silenced(INPUTS)
    exchange(talk, 1, unit=2)
    assert [lost_beside_another(talk, INPUTS) for _ in range(10)] == [1] * 10


def test_what_answers_again_is_asked_alone_again() -> None:
    talk = silenced()
    exchange(talk, 1, unit=2)
    assert 2 in [lost_beside_another(talk) for _ in range(3)]


def test_another_connection_knows_of_no_silent_units() -> None:
    talk = silenced()
    talk.reconnect()
    grow(talk)
    assert lost_beside_another(talk) == 2
