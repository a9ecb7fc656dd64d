"""Callers in bytes and times: their outcomes, cancellations and interruptions."""

import asyncio
import errno
import logging
from typing import Any

import pytest

from libmodbus_py import IllegalDataAddress, ModbusConnectionError, pdu
from libmodbus_py.client.call import Batch, Timeouts
from libmodbus_py.client.reconnecting import State
from libmodbus_py.ports.trace import TracedFrame
from tests.support.driver import ASCII, LINE, TCP, Driver, ascii_frame, kinds, tcp
from tests.support.replies import BOTH, answer, exchange, refusal


def test_a_trace_gets_every_frame_and_noise() -> None:
    for url, garbage in ((TCP, "0001 0007 0003 01 83 02"), (LINE, "55 AA 55 AA"), (ASCII, "3A")):
        frames: list[TracedFrame] = []
        driver = Driver(url, trace=frames.append, timeout=1)
        driver.ask(5)
        noise = bytes.fromhex(garbage)
        right = ascii_frame("01 03 02 0005") if url == ASCII else answer(driver)
        driver.come(noise)
        driver.come(right)
        driver.wait(0.03)
        assert [(frame.direction, frame.adu) for frame in (frames[0], frames[-1])] == [
            ("sent", driver.sent[0]),
            ("received", right),
        ]
        assert {(entry.unit, entry.function) for entry in (frames[0], frames[-1])} == {(1, 3)}
        if url != ASCII:
            assert frames[1].adu == noise
            assert (frames[1].unit, frames[1].function) == (None, None)
        assert all(frame.endpoint.startswith(url) for frame in frames)
        assert "unit 1, function 3: " in str(frames[0])


def test_the_logger_of_the_wire_has_the_same(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG, "libmodbus_py.wire"):
        driver = Driver()
        driver.ask(0x6B, unit=17)
        driver.come(answer(driver))
    assert "> unit 17, function 3: 00 01 00 00 00 06 11 03 00 6b 00 01" in caplog.text
    assert "< unit 17, function 3: 00 01 00 00 00 05 11 03 02 00 6b" in caplog.text


class Failing(pdu.ReadHoldingRegisters):
    """A request class that raises, by mistake or because of a signal."""

    __slots__ = ()
    error: BaseException

    def _decode_response(self, pdu: bytes) -> list[int]:
        raise type(self).error


@BOTH
@pytest.mark.parametrize(
    "error", [ZeroDivisionError(), ValueError(), KeyboardInterrupt(), asyncio.CancelledError()]
)
def test_an_exception_from_a_request_class_reaches_only_its_own_caller(url: str, error) -> None:
    kind = type("Kind", (Failing,), {"__slots__": (), "error": error})
    driver = Driver(url)
    for go_on in (True, False):
        before, batch, after = (
            driver.ask(1),
            driver.ask(2, kind(3, 1), 4, one_by_one=False, go_on=go_on),
            driver.ask(5),
        )
        while not (after.is_done and batch.is_done):
            driver.come(answer(driver))
            for at in range(len(driver.sent)):
                if driver.has_ids:
                    driver.come(answer(driver, at))
        assert (before.outcomes, after.outcomes) == ([[1]], [[5]])
        assert batch.outcomes[:2] == [[2], error]
        assert batch.is_done  # only a ModbusError is tolerated
    assert driver.is_at_rest


def test_requests_that_cannot_be_compared_have_no_effect_on_others() -> None:
    class Stubborn:
        def __eq__(self, other: object) -> bool:
            raise ValueError("the truth of an array is ambiguous")

        __hash__ = None  # type: ignore[assignment]

    class Array(pdu.ReadHoldingRegisters):
        __slots__ = ()

        def _decode_response(self, pdu: bytes) -> Any:
            return Stubborn()

    driver = Driver()
    batch = driver.ask(1, Array(2, 1), Array(3, 1), one_by_one=False)
    driver.come(answer(driver, 1), answer(driver, 2), refusal(driver, 2, 0))
    assert kinds(batch)[0] is IllegalDataAddress
    assert batch.is_done


def test_requests_that_were_not_sent_do_not_count_as_unanswered() -> None:
    driver = Driver(timeout=1, max_in_flight=1)
    driver.ask(1)
    for entry in [driver.ask(2), driver.ask(3), driver.ask(4)]:
        driver.cancel(entry)
    driver.wait(1)
    batch = driver.ask(5)
    assert driver.connection.broken is None
    driver.come(tcp(driver.sent[-1]))
    assert batch.outcomes == [[5]]


def test_requests_go_out_before_answers_are_decoded() -> None:
    driver = Driver(max_in_flight=2)
    batches = [driver.ask(1), driver.ask(2), driver.ask(3)]
    driver.connection.take([tcp(driver.sent[0])], driver.now)
    driver.start()
    assert not batches[0].is_done
    assert len(driver.sent) == 3
    driver.connection.take([tcp(driver.sent[1]), tcp(driver.sent[2])], driver.now)
    driver.connection.settle(driver.now)
    assert [batch.outcomes for batch in batches] == [[[1]], [[2]], [[3]]]


def test_a_batch_that_failed_while_it_waited_can_be_cancelled() -> None:
    driver = Driver(max_in_flight=4)
    batch = driver.ask(*range(9), one_by_one=False)
    assert len(driver.sent) == 4
    driver.come(tcp(driver.sent[3], "83 02"))
    driver.come(tcp(driver.sent[0]))
    driver.cancel(batch)
    assert driver.is_at_rest


INTERRUPTED = ModbusConnectionError("interrupted", errno=errno.EINTR)


@BOTH
def test_interrupted_requests_leave_nothing_behind(url: str) -> None:
    driver = Driver(url, timeout=1, busy_retries=1, turnaround=0.5)
    busy = driver.ask(1)
    driver.come(refusal(driver, 6))
    everyone = driver.ask(pdu.WriteRegister(1, 2), unit=0, is_broadcast=True)
    batch, queued = driver.ask(2), driver.ask(3)
    count = len(driver.sent)
    driver.connection.interrupted(INTERRUPTED, driver.now)
    assert driver.is_at_rest
    assert driver.life.state is State.DISCONNECTED
    # The write waits for the repetition before it.
    assert driver.statistics.results[6, "cancelled"] == 0
    driver.open()
    driver.wait(5)
    assert len(driver.sent) == count
    assert not any(call.is_done for call in (busy, everyone, batch, queued))
    exchange(driver, 7)


def test_an_interrupted_attempt_to_connect_is_abandoned() -> None:
    driver = Driver(is_open=False)
    driver.ask(1)
    driver.life.connecting()
    driver.connection.interrupted(INTERRUPTED, driver.now)
    assert driver.life.state is State.DISCONNECTED
    assert driver.is_at_rest
    driver.open()
    assert driver.sent == []


def test_a_connection_that_was_lost_begins_with_nothing_in_flight() -> None:
    driver = Driver(LINE, turnaround=5)
    everyone = driver.ask(pdu.WriteRegister(1, 2), unit=0, is_broadcast=True)
    driver.lose()
    assert kinds(everyone) == [ModbusConnectionError]
    assert driver.connection.in_flight == 0
    driver.open()
    driver.ask(1)
    driver.wait_for(2)
    assert driver.now < 5
    assert driver.connection.in_flight == 1


def test_a_batch_that_fails_keeps_the_outcomes_it_already_has() -> None:
    batch = Batch(1, [pdu.ReadCoils(0, 1), pdu.ReadCoils(1, 1)], Timeouts(1, 0, 0))
    batch.calls[1].settle("first")
    batch.settle(failure := ModbusConnectionError("interrupted", errno=errno.EINTR))
    assert batch.is_done
    assert batch.outcomes == [failure, "first"]
