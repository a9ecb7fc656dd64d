"""
What every connection decides, in bytes and times: timeouts, repetitions, pacing,
connections that come and go, and who is told what.
"""

from __future__ import annotations

import asyncio
import logging
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from libmodbus_py import (
    IllegalDataAddress,
    InvalidResponse,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    ServerDeviceBusy,
    pdu,
)
from libmodbus_py.client.call import NOT_ASKED, Batch
from libmodbus_py.ports.trace import Traced
from tests.support.peers import UNKNOWN_FUNCTION
from tests.support.talk import ASCII, LINE, LOST, TCP, Talk, ascii_frame, kinds, rtu, tcp, value

BOTH = pytest.mark.parametrize("url", [TCP, LINE])


def answer(talk: Talk, at: int = -1) -> bytes:
    """Answer a request of a single register with its address, whatever the framing."""
    adu = talk.sent[at]
    if talk.has_ids:
        return tcp(adu)
    return value(int.from_bytes(adu[2:4], "big"), unit=adu[0])


def refusal(talk: Talk, code: int, at: int = -1) -> bytes:
    adu = talk.sent[at]
    body = f"83 {code:02X}"
    return tcp(adu, body) if talk.has_ids else rtu(f"{adu[0]:02X} {body}")


def addresses(talk: Talk) -> list[int]:
    """Return the addresses of the requests, in their order."""
    first = 8 if talk.has_ids else 2
    return [int.from_bytes(each[first : first + 2], "big") for each in talk.sent]


# --- timeouts --------------------------------------------------------------------------


@BOTH
def test_a_request_has_its_time_and_no_more(url: str) -> None:
    talk = Talk(url, timeout=1)
    batch = talk.ask(5)
    talk.wait(0.999)
    assert not batch.is_done
    talk.wait(0.001)
    assert kinds(batch) == [ModbusTimeoutError]
    error = batch.outcomes[0]
    assert (error.unit, error.function, error.sent) == (1, 3, talk.sent[0])
    assert "no answer within 1 s" in str(error)
    assert talk.statistics.timeouts == 1
    assert talk.is_at_rest


def test_each_request_may_have_a_time_of_its_own() -> None:
    talk = Talk(timeout=1)
    long, short = talk.ask(1, timeout=3), talk.ask(2, timeout=0.2)
    usual = talk.ask(3)
    talk.wait(0.2)
    assert [long.is_done, short.is_done, usual.is_done] == [False, True, False]
    talk.wait(0.8)
    assert [long.is_done, usual.is_done] == [False, True]
    talk.wait(2)
    assert "within 3 s" in str(long.outcomes[0])


@pytest.mark.parametrize("timeout", [0.4, 3.0])
def test_a_timeout_that_is_changed_meanwhile_holds_at_once(timeout: float) -> None:
    talk = Talk(timeout=1)
    batch = talk.ask(1)
    talk.wait(0.2)
    talk.timeouts.timeout = timeout
    talk.connection.change_timeout(talk.now)
    talk.wait_until(timeout - 0.01)
    assert not batch.is_done
    talk.wait_until(timeout)
    assert batch.is_done


def test_waiting_for_others_requests_does_not_count() -> None:
    talk = Talk(LINE, timeout=1)
    batches = [talk.ask(number) for number in range(5)]
    for _ in range(5):
        talk.wait(0.9)
        talk.come(answer(talk))
    assert [batch.outcomes for batch in batches] == [[[number]] for number in range(5)]


@BOTH
def test_waiting_for_the_connection_counts(url: str) -> None:
    talk = Talk(url, timeout=1, is_open=False)
    batch = talk.ask(1, 2)
    talk.life.connecting()
    talk.wait(0.7)
    talk.connection.opened(talk.now)
    talk.start()
    talk.wait(0.29)
    assert not batch.is_done
    talk.wait(0.01)
    assert kinds(batch)[0] is ModbusTimeoutError


def test_who_has_waited_for_a_connection_for_too_long_is_told_so() -> None:
    talk = Talk(timeout=1, is_open=False)
    short, batch, joining = talk.ask(1, timeout=0.5), talk.ask(2, 3, go_on=True), talk.join()
    talk.life.connecting()
    talk.wait(0.5)
    assert "no connection to 192.0.2.1:502 within 0.5 s" in str(short.outcomes[0])
    assert not batch.is_done
    talk.wait(0.5)
    assert kinds(batch) == [ModbusConnectionError] * 2
    assert batch.outcomes[1].asked == "ReadHoldingRegisters(address=3, count=1)"
    assert joining.is_done
    assert "within 1 s" in str(joining.outcome)
    assert talk.is_at_rest


# --- dead connections ------------------------------------------------------------------


def test_after_three_timeouts_in_a_row_the_next_request_goes_over_a_new_connection() -> None:
    talk = Talk(timeout=1)
    for _ in range(3):
        talk.ask(1)
        assert talk.connection.broken is None
        talk.wait(1)
    batch = talk.ask(7)
    assert len(talk.sent) == 3
    talk.leave_broken()
    talk.open()
    talk.come(answer(talk))
    assert batch.outcomes == [[7]]
    assert talk.statistics.lost == 1


def test_a_dumb_host_is_asked_again_over_and_over() -> None:
    """Whoever polls a dead device behind a gateway finds it as soon as it is back."""
    talk = Talk(timeout=1)
    for _ in range(20):
        batch = talk.ask(1)
        if talk.connection.broken:
            talk.leave_broken()
            assert talk.connection.is_wanted
            talk.open()
        talk.wait(1)
        assert kinds(batch) == [ModbusTimeoutError]
    assert len(talk.sent) == 20
    assert talk.statistics.connects == 7


def test_cancelled_requests_count_as_unanswered() -> None:
    talk = Talk(timeout=1)
    for _ in range(3):
        batch = talk.ask(1)
        talk.wait(0.2)
        talk.cancel(batch)
    talk.ask(1)
    assert talk.connection.broken is not None


@pytest.mark.parametrize("life", ["its answer", "a late answer", "another's answer", "a refusal"])
def test_any_sign_of_life_starts_the_count_anew(life: str) -> None:
    talk = Talk(timeout=1)
    for _ in range(2):
        talk.ask(1)
        talk.wait(1)
    if life == "a late answer":
        talk.come(answer(talk, 0))
    elif life == "another's answer":
        talk.ask(2, unit=9)
        talk.come(answer(talk))
    else:
        talk.ask(2)
        talk.come(answer(talk) if life == "its answer" else refusal(talk, 2))
    for _ in range(2):
        talk.ask(1)
        talk.wait(1)
    talk.ask(1)
    assert talk.connection.broken is None


def test_an_answer_to_nobody_is_no_sign_of_life() -> None:
    talk = Talk(timeout=1)
    for _ in range(3):
        talk.ask(1)
        talk.come(tcp(talk.sent[-1], number=999))
        talk.wait(1)
    talk.ask(1)
    assert talk.connection.broken is not None


def test_requests_that_were_sent_before_the_last_answer_do_not_count() -> None:
    talk = Talk(timeout=1)
    for _ in range(5):
        talk.ask(1)
    talk.wait(0.5)
    talk.ask(2)
    talk.come(answer(talk))
    talk.wait(0.5)
    talk.ask(3)
    assert talk.connection.broken is None


def test_a_serial_port_never_counts_as_dead() -> None:
    talk = Talk(LINE, timeout=0.1)
    for _ in range(10):
        talk.ask(1)
        talk.wait(0.3)
    assert len(talk.sent) == 10


# --- connections that end --------------------------------------------------------------


@BOTH
def test_what_is_in_flight_fails_and_the_queue_waits_for_the_next_connection(url: str) -> None:
    talk = Talk(url, timeout=1, **({"max_in_flight": 2} if url == TCP else {}))
    batches = [talk.ask(number) for number in range(4)]
    in_flight = len(talk.sent)
    talk.lose()
    assert [batch.is_done for batch in batches] == [number < in_flight for number in range(4)]
    assert batches[0].outcomes[0].errno == 104
    assert batches[0].outcomes[0].sent == talk.sent[0]
    assert talk.connection.is_wanted
    talk.open()
    talk.wait(1)
    assert set(addresses(talk)) >= {0, 3} if url == TCP else True
    assert talk.statistics.lost == 1


def test_every_request_has_an_error_of_its_own() -> None:
    talk = Talk()
    batch = talk.ask(1, 2, 3, limit=16, go_on=True)
    talk.lose()
    assert len({id(each) for each in batch.outcomes}) == 3
    assert [each.sent for each in batch.outcomes] == talk.sent
    assert LOST.sent == b""


def test_nobody_has_a_connection_made_for_a_batch_that_is_decided() -> None:
    talk = Talk()
    batch = talk.ask(1, 2)
    talk.lose()
    assert kinds(batch) == [ModbusConnectionError, NOT_ASKED]
    assert not talk.connection.is_wanted
    talk = Talk(is_open=False)
    talk.cancel(talk.ask(1))
    assert not talk.connection.is_wanted


def test_three_fruitless_connections_fail_all_who_wait() -> None:
    talk = Talk(max_in_flight=1)
    batch = talk.ask(*range(10), go_on=True)
    for number in range(3):
        assert len(talk.sent) == number + 1
        talk.lose()
        if not batch.is_done:
            talk.open()
    assert kinds(batch) == [ModbusConnectionError] * 10
    assert [each.sent != b"" for each in batch.outcomes] == [True] * 3 + [False] * 7
    assert talk.is_at_rest


def test_an_answer_between_makes_connections_fruitful() -> None:
    talk = Talk(max_in_flight=1)
    batch = talk.ask(*range(10), go_on=True)
    for _ in range(5):
        talk.come(answer(talk))
        talk.lose()
        assert not batch.is_done or len(talk.sent) == 10
        talk.open()
    assert batch.outcomes[::2] == [[0], [2], [4], [6], [8]]
    assert kinds(batch)[1::2] == [ModbusConnectionError] * 5


def test_all_who_wait_share_one_attempt_and_its_failure() -> None:
    talk = Talk(is_open=False)
    batches = [talk.ask(number) for number in range(3)]
    joining = talk.join()
    talk.fail()
    assert [kinds(batch) for batch in batches] == [[ModbusConnectionError]] * 3
    assert {batch.outcomes[0].errno for batch in batches} == {111}
    assert joining.outcome is not None
    assert joining.outcome.unit == 1
    assert len({id(batch.outcomes[0]) for batch in batches}) == 3


@BOTH
def test_closed_is_closed(url: str) -> None:
    talk = Talk(url, retries=3)
    asked, waiting, unsent = talk.ask(1), talk.ask(2), talk.ask(3)
    talk.connection.closed(ModbusConnectionError("this client is closed", errno=9), talk.now)
    for batch in (asked, waiting, unsent, talk.ask(4)):
        assert kinds(batch) == [ModbusConnectionError]
        assert batch.outcomes[0].errno == 9
    assert talk.is_at_rest
    joining = talk.join()
    assert "closed" in str(joining.outcome)


def test_who_asks_only_for_the_connection_is_done_when_it_stands() -> None:
    talk = Talk(is_open=False)
    joining = talk.join()
    assert not joining.is_done
    talk.open()
    assert joining.is_done
    assert joining.outcome is None
    assert talk.join().is_done


# --- repetitions -----------------------------------------------------------------------


@BOTH
def test_a_request_without_an_answer_is_asked_again(url: str) -> None:
    talk = Talk(url, timeout=1, retries=2)
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
    talk = Talk(url, timeout=1, retries=1, timeouts_before_reconnect=9)
    batch = talk.ask(5)
    for count in (1, 2):
        talk.wait_for(count)
        if trouble == "loss":
            talk.lose()
            talk.open()
        elif trouble == "invalid":
            body = "04 02 0005"
            talk.come(tcp(talk.sent[-1], body) if url == TCP else rtu("01 " + body))
            if url != TCP:  # there the answer may still come
                talk.wait(1)
        else:
            talk.wait(1)
    expected = {"silence": ModbusTimeoutError, "loss": ModbusConnectionError}
    assert kinds(batch) == [expected.get(trouble, InvalidResponse)]
    assert len(talk.sent) == 2
    assert talk.is_at_rest


def test_a_damaged_answer_is_asked_for_again() -> None:
    talk = Talk(LINE, timeout=1, retries=1)
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
    talk = Talk(timeout=1, retries=5)
    batch = talk.ask(request_)
    talk.wait(3)
    assert kinds(batch) == [ModbusTimeoutError]
    assert len(talk.sent) == 1


def test_a_refusal_is_not_repeated() -> None:
    talk = Talk(retries=5, busy_retries=5)
    batch = talk.ask(5)
    talk.come(refusal(talk, 2))
    assert kinds(batch) == [IllegalDataAddress]


@BOTH
def test_a_busy_device_is_asked_again_after_growing_pauses(url: str) -> None:
    """0.1, 0.2, 0.4, 0.8, 1, 1 s; what may not be sent twice was not carried out."""
    talk = Talk(url, busy_retries=6)
    batch = talk.ask(pdu.Diagnostics(0, b"\0\1"))
    for code in (6, 5, 6, 5, 6, 5, 6):
        body = f"88 {code:02X}"
        talk.come(tcp(talk.sent[-1], body) if url == TCP else rtu("01 " + body))
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
    talk = Talk(url, timeout=1, retries=1, busy_retries=1)
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
    talk = Talk(busy_retries=1)
    batch = talk.ask(*range(4), limit=2)
    talk.come(refusal(talk, 6, 0))
    assert addresses(talk) == [0, 1]
    talk.come(answer(talk, 1))
    assert addresses(talk) == [0, 1, 2]
    talk.wait(0.1)
    assert addresses(talk) == [0, 1, 2, 0]
    talk.come(answer(talk, 2), answer(talk, 3))
    talk.come(answer(talk))
    assert batch.outcomes == [[0], [1], [2], [3]]


def test_what_comes_behind_a_failure_is_not_repeated() -> None:
    talk = Talk(busy_retries=5)
    batch = talk.ask(0, 1, 2, limit=16)
    talk.come(refusal(talk, 6, 2), refusal(talk, 2, 1))
    talk.wait(0.5)
    assert addresses(talk) == [0, 1, 2]
    talk.come(answer(talk, 0))
    assert kinds(batch)[:2] == [[0], IllegalDataAddress]
    assert talk.is_at_rest


@BOTH
def test_others_are_asked_during_a_pause(url: str) -> None:
    talk = Talk(url, busy_retries=1)
    busy = talk.ask(1)
    talk.come(refusal(talk, 6))
    other = talk.ask(2, unit=2)
    talk.come(answer(talk))
    assert other.outcomes == [[2]]
    talk.wait(0.1)
    talk.come(answer(talk))
    assert busy.outcomes == [[1]]


def test_a_repetition_over_a_new_connection_waits_for_it_no_longer_than_a_timeout() -> None:
    talk = Talk(timeout=1, retries=1)
    batch = talk.ask(1)
    talk.lose()
    assert talk.connection.is_wanted
    talk.wait(1)
    assert kinds(batch) == [ModbusConnectionError]
    assert "no connection" in str(batch.outcomes[0])
    assert not talk.connection.is_wanted


@BOTH
def test_a_cancelled_repetition_is_forgotten(url: str) -> None:
    talk = Talk(url, busy_retries=1)
    batch = talk.ask(1)
    talk.come(refusal(talk, 6))
    talk.cancel(batch)
    talk.wait(5)
    assert len(talk.sent) == 1
    assert talk.is_at_rest


# --- pacing ----------------------------------------------------------------------------


def test_requests_are_spaced() -> None:
    talk = Talk(request_spacing=0.25)
    talk.ask(*range(3), limit=16)
    talk.ask(9)
    talk.wait(1)
    assert talk.times == pytest.approx([0, 0.25, 0.5, 0.75])
    talk.wait(1)
    talk.ask(5)
    assert talk.times[-1] == 2


@BOTH
def test_a_device_gets_its_time_after_connecting_which_is_not_the_requests(url: str) -> None:
    talk = Talk(url, connect_delay=0.5, timeout=0.3)
    batch = talk.ask(1)
    talk.wait(0.49)
    assert talk.sent == []
    talk.wait(0.01)
    talk.wait(0.29)
    talk.come(answer(talk))
    assert batch.outcomes == [[1]]


# --- requests that nobody answers ------------------------------------------------------


def test_a_broadcast_takes_the_turnaround_and_the_whole_line() -> None:
    talk = Talk(LINE, turnaround=0.2)
    everyone = talk.ask(pdu.WriteRegister(1, 2), unit=0, is_broadcast=True)
    assert talk.sent == [bytes.fromhex("00 06 0001 0002 581A")]
    batch = talk.ask(5)
    talk.wait(0.19)
    assert (everyone.is_done, len(talk.sent)) == (False, 1)
    talk.wait(0.01)
    assert everyone.outcomes == [None]
    talk.come(value(5))
    assert batch.outcomes == [[5]]
    assert talk.statistics.timeouts == 0


def test_a_broadcast_that_was_cancelled_still_has_the_line() -> None:
    talk = Talk(LINE, turnaround=0.2)
    talk.cancel(talk.ask(pdu.WriteRegister(1, 2), unit=0, is_broadcast=True))
    talk.ask(5)
    talk.wait(0.19)
    assert len(talk.sent) == 1
    talk.wait(0.01)
    assert len(talk.sent) == 2


def test_a_request_that_nobody_answers_makes_a_batch_go_one_by_one() -> None:
    silent = pdu.Diagnostics(pdu.SubFunction.FORCE_LISTEN_ONLY, b"\0\0")
    talk = Talk(turnaround=0.1)
    batch = talk.ask(1, silent, 2, limit=16)
    assert len(talk.sent) == 1
    talk.come(answer(talk))
    assert len(talk.sent) == 2
    talk.wait(0.1)
    talk.come(answer(talk))
    assert batch.outcomes == [[1], None, [2]]


def test_a_broadcast_on_a_connection_that_ends_fails() -> None:
    talk = Talk(LINE)
    batch = talk.ask(pdu.WriteRegister(1, 2), unit=0, is_broadcast=True)
    talk.lose()
    assert kinds(batch) == [ModbusConnectionError]


# --- who is told what ------------------------------------------------------------------


@BOTH
def test_all_is_counted(url: str) -> None:
    talk = Talk(url, timeout=1, retries=1)
    talk.ask(1)
    talk.come(answer(talk))
    talk.wait_until(1)
    talk.ask(2)
    talk.come(refusal(talk, 2))
    talk.ask(3, retries=0)
    talk.wait(1)
    talk.come(answer(talk))
    talk.lose()
    statistics = talk.statistics
    assert (statistics.requests, statistics.responses, statistics.exceptions) == (3, 2, 1)
    assert (statistics.timeouts, statistics.late_answers, statistics.retries) == (1, 1, 0)
    assert (statistics.connects, statistics.lost, statistics.failed_connects) == (1, 1, 0)
    assert statistics.last_success == 1
    talk.fail()
    assert statistics.failed_connects == 1


def test_a_trace_is_told_of_everything() -> None:
    for url, garbage in ((TCP, "0001 0007 0003 01 83 02"), (LINE, "55 AA 55 AA"), (ASCII, "3A")):
        told: list[Traced] = []
        talk = Talk(url, trace=told.append, timeout=1)
        talk.ask(5)
        noise = bytes.fromhex(garbage)
        right = ascii_frame("01 03 02 0005") if url == ASCII else answer(talk)
        talk.come(noise)
        talk.come(right)
        talk.wait(0.03)
        assert [(each.direction, each.adu) for each in (told[0], told[-1])] == [
            ("sent", talk.sent[0]),
            ("received", right),
        ]
        assert {(each.unit, each.function) for each in (told[0], told[-1])} == {(1, 3)}
        if url != ASCII:
            assert told[1].adu == noise
            assert (told[1].unit, told[1].function) == (None, None)
        assert all(each.endpoint.startswith(url) for each in told)
        assert "unit 1, function 3: " in str(told[0])


@BOTH
def test_a_trace_that_fails_harms_nobody(url: str, caplog: pytest.LogCaptureFixture) -> None:
    def broken(traced: Traced) -> None:
        raise ZeroDivisionError

    talk = Talk(url, trace=broken)
    batch = talk.ask(5)
    talk.come(answer(talk))
    assert batch.outcomes == [[5]]
    assert [record.exc_info is not None for record in caplog.records] == [True, True]


def test_the_logger_of_the_wire_has_the_same(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG, "libmodbus_py.wire"):
        talk = Talk()
        talk.ask(0x6B, unit=17)
        talk.come(answer(talk))
    assert "> unit 17, function 3: 00 01 00 00 00 06 11 03 00 6b 00 01" in caplog.text
    assert "< unit 17, function 3: 00 01 00 00 00 05 11 03 02 00 6b" in caplog.text


class Failing(pdu.ReadHoldingRegisters):
    """A request class with a mistake in it, or one that a signal meets."""

    __slots__ = ()
    error: BaseException

    def _decode_response(self, pdu: bytes) -> list[int]:
        raise type(self).error


@BOTH
@pytest.mark.parametrize(
    "error", [ZeroDivisionError(), ValueError(), KeyboardInterrupt(), asyncio.CancelledError()]
)
def test_what_a_request_class_raises_reaches_its_own_caller_only(
    url: str, error: BaseException
) -> None:
    kind = type("Kind", (Failing,), {"__slots__": (), "error": error})
    talk = Talk(url)
    for go_on in (True, False):
        before, batch, after = (
            talk.ask(1),
            talk.ask(2, kind(3, 1), 4, limit=16, go_on=go_on),
            talk.ask(5),
        )
        while not (after.is_done and batch.is_done):
            talk.come(answer(talk))
            for at in range(len(talk.sent)):
                if talk.has_ids:
                    talk.come(answer(talk, at))
        assert (before.outcomes, after.outcomes) == ([[1]], [[5]])
        assert batch.outcomes[:2] == [[2], error]
        assert batch.is_done  # nothing is tolerated but a ModbusError
    assert talk.is_at_rest


def test_an_outcome_that_cannot_be_compared_harms_nobody() -> None:
    class Stubborn:
        def __eq__(self, other: object) -> bool:
            raise ValueError("the truth of an array is ambiguous")

        __hash__ = None  # type: ignore[assignment]

    class Array(pdu.ReadHoldingRegisters):
        __slots__ = ()

        def _decode_response(self, pdu: bytes) -> Any:
            return Stubborn()

    talk = Talk()
    batch = talk.ask(1, Array(2, 1), Array(3, 1), limit=16)
    talk.come(answer(talk, 1), answer(talk, 2), refusal(talk, 2, 0))
    assert kinds(batch)[0] is IllegalDataAddress
    assert batch.is_done


# --- whatever happens ------------------------------------------------------------------


ASKING = ["ask", "ask", "many", "cancel", "broadcast"]
COMING = ["answer", "answer", "late", "refuse", "busy", "noise", "foreign", "half"]
PASSING = ["wait", "wait", "long wait", "lose"]

EVENTS = st.lists(
    st.tuples(st.sampled_from([*ASKING, *COMING, *PASSING]), st.integers(0, 255)), max_size=60
)


@pytest.mark.parametrize("url", [TCP, TCP.replace("tcp", "udp"), LINE, "rtu+tcp://192.0.2.1"])
@given(events=EVENTS, retries=st.integers(0, 2), spacing=st.sampled_from([0.0, 0.05]))
@settings(max_examples=150)
def test_no_schedule_gives_a_wrong_value_leaves_anybody_waiting_or_leaks_a_slot(
    url: str, events: list[tuple[str, int]], retries: int, spacing: float
) -> None:
    """On a line no answer comes later than two timeouts after its request: who may wait so long?"""
    talk = Talk(url, timeout=1, retries=retries, busy_retries=1, request_spacing=spacing)
    asked: list[tuple[Batch, list[int]]] = []
    number = 0
    for event, choice in events:
        if event in ("ask", "many"):
            count = 1 if event == "ask" else choice % 5
            numbers = list(range(number, number + count))
            number += count
            batch = talk.ask(
                *numbers, unit=choice % 2 + 1, limit=choice % 4 + 1, go_on=choice > 127
            )
            asked.append((batch, numbers))
        elif event == "cancel" and asked:
            talk.cancel(asked[choice % len(asked)][0])
        elif event == "broadcast":
            if "rtu" in url:
                talk.ask(pdu.WriteRegister(1, 2), unit=0, is_broadcast=True)
        elif event == "lose":
            talk.lose()
            talk.open()
        elif event.endswith("wait"):
            talk.wait(choice / 100 if event == "wait" else 4)
        elif talk.sent:
            happen(talk, event, choice)
        if talk.connection.broken is not None:
            talk.leave_broken()
            talk.open()
    settle_down(talk)
    for batch, numbers in asked:
        assert batch.is_done
        for expected, outcome in zip(numbers, batch.outcomes, strict=True):
            is_none = outcome is NOT_ASKED or isinstance(outcome, ModbusError)
            assert is_none or outcome == [expected]
    assert talk.is_at_rest
    talk.life.prove()  # who has lost three connections in a row may be refused
    count = len(talk.sent)
    last = talk.ask(77, unit=3, timeout=10)
    if talk.connection.broken is not None:
        talk.leave_broken()
        talk.open()
    talk.wait_for(count + 1)
    talk.come(answer(talk))
    talk.wait(1)
    assert last.outcomes == [[77]]


def happen(talk: Talk, event: str, choice: int) -> None:
    """Something comes in, whole or in pieces."""
    is_line = not talk.has_ids
    # On a line only the last request can be answered at the right time.
    at = -1 if is_line else -1 - choice % min(8, len(talk.sent))
    if is_line and talk.sent[-1][0] == 0:
        return
    data = {
        "answer": lambda: answer(talk, at),
        "late": lambda: answer(talk, at),
        "refuse": lambda: refusal(talk, 2, at),
        "busy": lambda: refusal(talk, 6, at),
        "noise": lambda: bytes([choice]) if is_line else tcp(talk.sent[at], protocol=7),
        "foreign": lambda: value(9, unit=9) if is_line else tcp(talk.sent[at], number=0xFFFF),
        "half": lambda: answer(talk, at)[: choice % 7 + 1],
    }[event]()
    cut = choice % len(data)
    pieces = [data] if talk.is_udp else [data[:cut], data[cut:]]
    pieces = [each for each in pieces if each]  # no port reads nothing
    if (
        is_line
        and event in ("answer", "late", "refuse", "busy")
        and talk.now - talk.times[-1] > 1.99
    ):
        return  # later than anybody can know
    talk.come(*pieces)


def settle_down(talk: Talk) -> None:
    """Nobody answers any more: every deadline passes, over as many connections as it takes."""
    for _ in range(2000):
        if talk.is_at_rest:
            return
        talk.wait(1)
        if talk.connection.broken is not None:
            talk.leave_broken()
            talk.open()
    raise AssertionError("somebody waits for ever")


def test_a_batch_without_requests_is_over_at_once_on_a_connection_that_stands() -> None:
    talk = Talk()
    batch = talk.batch()
    talk.connection.submit(batch, talk.now)
    assert batch.is_done
    assert talk.is_at_rest
