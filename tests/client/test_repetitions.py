"""Requests that are sent again, in bytes and times: when, and what becomes of those beside them."""

from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py import (
    IllegalDataAddress,
    InvalidResponse,
    ModbusConnectionError,
    ModbusTimeoutError,
    ServerDeviceBusy,
    pdu,
)
from tests.support.cases import each_case
from tests.support.driver import LINE, TCP, Driver, kinds, tcp, value
from tests.support.peers import UNKNOWN_FUNCTION
from tests.support.replies import BOTH, addresses, answer, exchange, refusal, reply


def test_all_that_are_due_leave_together() -> None:
    talk = Driver(busy_retries=1)
    batches = [talk.ask(number) for number in range(3)]
    talk.come(*[tcp(each, "83 06") for each in talk.sent])
    talk.now = 0.1
    talk.connection.tick(talk.now)
    talk.forget()
    talk.start()
    assert len(talk.sent) == 3
    assert not any(batch.is_done for batch in batches)


def test_they_are_spaced_as_all_requests_are() -> None:
    talk = Driver(busy_retries=1, request_spacing=0.25)
    for number in range(3):
        talk.ask(number)
    talk.wait(0.5)
    talk.come(*[tcp(each, "83 06") for each in talk.sent])
    talk.wait(2)
    assert [round(at, 3) for at in talk.times] == [0, 0.25, 0.5, 0.75, 1.0, 1.25]


def values(talk: Driver) -> list[int]:
    """Return what the writes that were sent write."""
    at = 7 if talk.has_ids else 1
    return [int.from_bytes(adu[at + 3 : at + 5], "big") for adu in talk.sent if adu[at] == 6]


TROUBLES: dict[str, Callable[[Driver], object]] = {
    "busy": lambda talk: talk.come(reply(talk, "86 06", 0)),
    "silence": lambda talk: talk.wait(1),
    "loss": Driver.reconnect,
}


@each_case("url", [TCP, "rtu+tcp://192.0.2.1"])
@each_case("trouble", TROUBLES)
def test_an_older_write_is_never_sent_after_a_newer_one(url: str, trouble: str) -> None:
    """Two tasks with one client: the newer write waits until the older one is over."""
    talk = Driver(url, timeout=1, retries=1, busy_retries=1, max_pause=0)
    older = talk.ask(pdu.WriteRegister(1, 1))
    newer = talk.ask(pdu.WriteRegister(1, 2))
    assert values(talk) == [1]
    TROUBLES[trouble](talk)
    talk.wait_for(2)
    assert values(talk) == [1, 1]
    talk.come(talk.sent[-1])
    talk.wait_for(3)  # on a line the answer may be held
    talk.come(talk.sent[-1])
    talk.wait(0.5)
    assert (older.outcomes, newer.outcomes) == ([None], [None])
    assert values(talk) == [1, 1, 2]


def busy(talk: Driver) -> None:
    talk.come(reply(talk, "83 06"))


@each_case("url", [TCP, "rtu+tcp://192.0.2.1"])
@each_case("trouble", {"busy": busy, "silence": TROUBLES["silence"], "loss": Driver.reconnect})
def test_a_write_waits_for_the_repetitions_of_the_read_before_it(url: str, trouble: str) -> None:
    talk = Driver(url, timeout=1, retries=1, busy_retries=1, max_pause=0)
    read, write, after = talk.ask(1), talk.ask(pdu.WriteRegister(1, 9)), talk.ask(2)
    {**TROUBLES, "busy": busy}[trouble](talk)
    talk.wait_for(2)
    assert values(talk) == []
    talk.come(answer(talk))
    talk.wait_for(3)
    assert read.outcomes == [[1]]
    assert values(talk) == [9]
    talk.come(talk.sent[-1])
    talk.wait_for(4)
    talk.come(answer(talk))
    talk.wait(1)
    assert (write.outcomes, after.outcomes) == ([None], [[2]])


def test_no_write_is_sent_before_the_answer_to_the_read_before_it_is_decoded() -> None:
    """As drivers do, what may be sent is asked for between receiving and decoding."""
    talk = Driver(busy_retries=1)
    batch = talk.ask(1, pdu.WriteRegister(1, 9))
    talk.connection.take([tcp(talk.sent[-1], "83 02")], talk.now)
    assert not talk.connection.start(talk.now, talk.receive)
    talk.connection.settle(talk.now)
    assert kinds(batch)[0] is IllegalDataAddress
    assert not talk.connection.start(talk.now, talk.receive)
    assert talk.is_at_rest


def test_what_waits_behind_a_repetition_fails_with_it_when_no_connection_is_made() -> None:
    for url in (LINE, TCP):
        talk = Driver(url, timeout=1, retries=3)
        batch = talk.ask(1, 2, 3, go_on=True)
        talk.wait(1.5)
        talk.lose()
        talk.fail()
        assert kinds(batch) == [ModbusConnectionError] * 3
        assert batch.is_done


@BOTH
def test_a_request_without_an_answer_is_asked_again(url: str) -> None:
    talk = Driver(url, timeout=1, retries=2)
    batch = talk.ask(5)
    talk.wait_for(3)  # on a line only after it has fallen silent
    assert talk.times == pytest.approx([0, 1, 2] if url == TCP else [0, 2, 4])
    talk.come(answer(talk))
    if url != TCP:  # held until its time is over, because another answer may follow
        assert not batch.is_done
        talk.wait(1)
    assert batch.outcomes == [[5]]
    assert talk.statistics.retries == 2
    assert talk.is_at_rest


@BOTH
@pytest.mark.parametrize("trouble", ["silence", "loss", "invalid"])
def test_repetitions_come_to_an_end(url: str, trouble: str) -> None:
    talk = Driver(url, timeout=1, retries=1, timeouts_before_reconnect=9)
    batch = talk.ask(5)
    for count in (1, 2):
        talk.wait_for(count)
        if trouble == "loss":
            talk.reconnect()
        elif trouble == "invalid":
            talk.come(reply(talk, "04 02 0005"))
            if url != TCP:  # there the answer may still come
                talk.wait(1)
        else:
            talk.wait(1)
    expected = {"silence": ModbusTimeoutError, "loss": ModbusConnectionError}
    assert kinds(batch) == [expected.get(trouble, InvalidResponse)]
    assert len(talk.sent) == 2
    assert talk.is_at_rest


def test_a_damaged_answer_is_asked_for_again() -> None:
    talk = Driver(LINE, timeout=1, retries=1)
    batch = talk.ask(5)
    talk.come(value(5)[:-1] + b"\0")
    talk.wait_for(2)
    assert talk.now == pytest.approx(1, abs=0.05)  # one timeout after the end of the frame
    talk.come(value(5))
    talk.wait(1)  # held, because another answer may follow
    assert batch.outcomes == [[5]]
    assert talk.statistics.retries == 1


@pytest.mark.parametrize(
    "request_",
    [
        pdu.Diagnostics(10, b"\0\0"),
        pdu.EncapsulatedTransport(13, b""),
        pdu.RawRequest(UNKNOWN_FUNCTION),
    ],
)
def test_what_must_not_be_carried_out_twice_is_sent_once(request_: pdu.Request[Any]) -> None:
    talk = Driver(timeout=1, retries=5)
    batch = talk.ask(request_)
    talk.wait(3)
    assert kinds(batch) == [ModbusTimeoutError]
    assert len(talk.sent) == 1


@BOTH
def test_a_busy_device_is_asked_again_after_growing_pauses(url: str) -> None:
    """0.1, 0.2, 0.4, 0.8, 1, 1 s; what may not be sent twice was not carried out."""
    talk = Driver(url, busy_retries=6)
    batch = talk.ask(pdu.Diagnostics(0, b"\0\1"))
    for code in (6, 5, 6, 5, 6, 5, 6):
        talk.come(reply(talk, f"88 {code:02X}"))
        talk.wait(1)
    assert kinds(batch) == [ServerDeviceBusy]
    assert talk.times[1] == pytest.approx(0.1)
    assert talk.times[2] == pytest.approx(1.2)
    assert talk.times[5] == pytest.approx(5)
    assert len(talk.sent) == 7
    assert talk.statistics.exceptions == 7
    assert talk.statistics.retries == 6


@BOTH
def test_nothing_overtakes_a_repetition_with_one_in_flight(url: str) -> None:
    talk = Driver(url, timeout=1, retries=1, busy_retries=1)
    batch = talk.ask(10, 11, 12)
    talk.come(refusal(talk, 6))
    assert addresses(talk) == [10]
    talk.wait(0.1)
    talk.come(answer(talk))
    talk.wait_for(4)
    assert addresses(talk) == [10, 10, 11, 11]
    talk.come(answer(talk))
    talk.wait_for(5)  # on a line the answer is held: another one may follow
    talk.come(answer(talk))
    assert batch.outcomes == [[10], [11], [12]]
    assert addresses(talk) == [10, 10, 11, 11, 12]
    assert talk.is_at_rest


def test_a_repetition_keeps_its_place_among_those_in_flight() -> None:
    talk = Driver(busy_retries=1, max_in_flight=2)
    batch = talk.ask(*range(4), one_by_one=False)
    talk.come(refusal(talk, 6, 0))
    assert addresses(talk) == [0, 1]
    talk.come(answer(talk, 1))
    assert addresses(talk) == [0, 1, 2]
    talk.wait(0.1)
    assert addresses(talk) == [0, 1, 2, 0]
    talk.come(answer(talk, 2), answer(talk, 3))
    talk.come(answer(talk))
    assert batch.outcomes == [[0], [1], [2], [3]]


def test_nothing_more_of_a_batch_is_sent_once_a_refusal_was_received() -> None:
    talk = Driver(max_in_flight=2)
    batch = talk.ask(*range(9), one_by_one=False)
    talk.come(refusal(talk, 2, 0))
    assert addresses(talk) == [0, 1]
    assert kinds(batch)[0] is IllegalDataAddress
    assert talk.is_at_rest


def test_what_comes_behind_a_failure_is_not_repeated() -> None:
    talk = Driver(retries=5, busy_retries=5)
    batch = talk.ask(0, 1, 2, one_by_one=False)
    talk.come(refusal(talk, 6, 2), refusal(talk, 2, 1))
    talk.wait(0.5)
    assert addresses(talk) == [0, 1, 2]
    talk.come(answer(talk, 0))
    assert kinds(batch)[:2] == [[0], IllegalDataAddress]
    assert talk.is_at_rest


@BOTH
def test_others_are_asked_during_a_pause(url: str) -> None:
    talk = Driver(url, busy_retries=1)
    busy = talk.ask(1)
    talk.come(refusal(talk, 6))
    exchange(talk, 2, unit=2)
    talk.wait(0.1)
    talk.come(answer(talk))
    assert busy.outcomes == [[1]]


def test_a_repetition_over_a_new_connection_waits_for_it_no_longer_than_a_timeout() -> None:
    talk = Driver(timeout=1, retries=1)
    batch = talk.ask(1)
    talk.lose()
    assert talk.connection.is_wanted
    talk.wait(1)
    assert kinds(batch) == [ModbusConnectionError]
    assert "no connection" in str(batch.outcomes[0])
    assert not talk.connection.is_wanted


@BOTH
def test_a_cancelled_repetition_is_forgotten(url: str) -> None:
    talk = Driver(url, busy_retries=1)
    batch = talk.ask(1)
    talk.come(refusal(talk, 6))
    assert talk.connection.is_wanted
    talk.cancel(batch)
    assert talk.is_at_rest
    talk.wait(5)
    assert len(talk.sent) == 1
    assert talk.is_at_rest
