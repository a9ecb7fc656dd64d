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


def test_repetitions_that_are_due_are_sent_together() -> None:
    driver = Driver(busy_retries=1)
    batches = [driver.ask(number) for number in range(3)]
    driver.come(*[tcp(frame, "83 06") for frame in driver.sent])
    driver.now = 0.1
    driver.connection.tick(driver.now)
    driver.forget()
    driver.start()
    assert len(driver.sent) == 3
    assert not any(batch.is_done for batch in batches)


def test_repetitions_keep_the_spacing_of_requests() -> None:
    driver = Driver(busy_retries=1, request_spacing=0.25)
    for number in range(3):
        driver.ask(number)
    driver.wait(0.5)
    driver.come(*[tcp(frame, "83 06") for frame in driver.sent])
    driver.wait(2)
    assert [round(at, 3) for at in driver.times] == [0, 0.25, 0.5, 0.75, 1.0, 1.25]


def values(driver: Driver) -> list[int]:
    """Return the values of the writes that were sent."""
    at = 7 if driver.has_ids else 1
    return [int.from_bytes(adu[at + 3 : at + 5], "big") for adu in driver.sent if adu[at] == 6]


TROUBLES: dict[str, Callable[[Driver], object]] = {
    "busy": lambda driver: driver.come(reply(driver, "86 06", 0)),
    "silence": lambda driver: driver.wait(1),
    "loss": Driver.reconnect,
}


@each_case("url", [TCP, "rtu+tcp://192.0.2.1"])
@each_case("trouble", TROUBLES)
def test_an_older_write_is_never_sent_after_a_newer_one(url: str, trouble: str) -> None:
    """Two tasks with one client: the newer write waits until the older one is over."""
    driver = Driver(url, timeout=1, retries=1, busy_retries=1, max_pause=0)
    older = driver.ask(pdu.WriteRegister(1, 1))
    newer = driver.ask(pdu.WriteRegister(1, 2))
    assert values(driver) == [1]
    TROUBLES[trouble](driver)
    driver.wait_for(2)
    assert values(driver) == [1, 1]
    driver.come(driver.sent[-1])
    driver.wait_for(3)  # on a line the answer may be held
    driver.come(driver.sent[-1])
    driver.wait(0.5)
    assert (older.outcomes, newer.outcomes) == ([None], [None])
    assert values(driver) == [1, 1, 2]


def busy(driver: Driver) -> None:
    driver.come(reply(driver, "83 06"))


@each_case("url", [TCP, "rtu+tcp://192.0.2.1"])
@each_case("trouble", {"busy": busy, "silence": TROUBLES["silence"], "loss": Driver.reconnect})
def test_a_write_waits_for_the_repetitions_of_the_read_before_it(url: str, trouble: str) -> None:
    driver = Driver(url, timeout=1, retries=1, busy_retries=1, max_pause=0)
    read, write, after = driver.ask(1), driver.ask(pdu.WriteRegister(1, 9)), driver.ask(2)
    {**TROUBLES, "busy": busy}[trouble](driver)
    driver.wait_for(2)
    assert values(driver) == []
    driver.come(answer(driver))
    driver.wait_for(3)
    assert read.outcomes == [[1]]
    assert values(driver) == [9]
    driver.come(driver.sent[-1])
    driver.wait_for(4)
    driver.come(answer(driver))
    driver.wait(1)
    assert (write.outcomes, after.outcomes) == ([None], [[2]])


def test_no_write_is_sent_before_the_answer_to_the_read_before_it_is_decoded() -> None:
    """As drivers do, what may be sent is asked for between receiving and decoding."""
    driver = Driver(busy_retries=1)
    batch = driver.ask(1, pdu.WriteRegister(1, 9))
    driver.connection.take([tcp(driver.sent[-1], "83 02")], driver.now)
    assert not driver.connection.start(driver.now, driver.receive)
    driver.connection.settle(driver.now)
    assert kinds(batch)[0] is IllegalDataAddress
    assert not driver.connection.start(driver.now, driver.receive)
    assert driver.is_at_rest


def test_requests_that_wait_for_a_repetition_fail_with_it_when_no_connection_is_made() -> None:
    for url in (LINE, TCP):
        driver = Driver(url, timeout=1, retries=3)
        batch = driver.ask(1, 2, 3, go_on=True)
        driver.wait(1.5)
        driver.lose()
        driver.fail()
        assert kinds(batch) == [ModbusConnectionError] * 3
        assert batch.is_done


@BOTH
def test_a_request_without_an_answer_is_asked_again(url: str) -> None:
    driver = Driver(url, timeout=1, retries=2)
    batch = driver.ask(5)
    driver.wait_for(3)  # on a line only after it has fallen silent
    assert driver.times == pytest.approx([0, 1, 2] if url == TCP else [0, 2, 4])
    driver.come(answer(driver))
    if url != TCP:  # held until its time is over, because another answer may follow
        assert not batch.is_done
        driver.wait(1)
    assert batch.outcomes == [[5]]
    assert driver.statistics.retries == 2
    assert driver.is_at_rest


@BOTH
@pytest.mark.parametrize("trouble", ["silence", "loss", "invalid"])
def test_repetitions_come_to_an_end(url: str, trouble: str) -> None:
    driver = Driver(url, timeout=1, retries=1, timeouts_before_reconnect=9)
    batch = driver.ask(5)
    for count in (1, 2):
        driver.wait_for(count)
        if trouble == "loss":
            driver.reconnect()
        elif trouble == "invalid":
            driver.come(reply(driver, "04 02 0005"))
            if url != TCP:  # on TCP the answer may still come
                driver.wait(1)
        else:
            driver.wait(1)
    errors = {"silence": ModbusTimeoutError, "loss": ModbusConnectionError}
    assert kinds(batch) == [errors.get(trouble, InvalidResponse)]
    assert len(driver.sent) == 2
    assert driver.is_at_rest


def test_a_damaged_answer_is_asked_for_again() -> None:
    driver = Driver(LINE, timeout=1, retries=1)
    batch = driver.ask(5)
    driver.come(value(5)[:-1] + b"\0")
    driver.wait_for(2)
    assert driver.now == pytest.approx(1, abs=0.05)  # one timeout after the end of the frame
    driver.come(value(5))
    driver.wait(1)  # held, because another answer may follow
    assert batch.outcomes == [[5]]
    assert driver.statistics.retries == 1


@pytest.mark.parametrize(
    "request_",
    [
        pdu.Diagnostics(10, b"\0\0"),
        pdu.EncapsulatedTransport(13, b""),
        pdu.RawRequest(UNKNOWN_FUNCTION),
    ],
)
def test_requests_that_must_not_run_twice_are_sent_once(request_: pdu.Request[Any]) -> None:
    driver = Driver(timeout=1, retries=5)
    batch = driver.ask(request_)
    driver.wait(3)
    assert kinds(batch) == [ModbusTimeoutError]
    assert len(driver.sent) == 1


@BOTH
def test_a_busy_device_is_asked_again_after_growing_pauses(url: str) -> None:
    """0.1, 0.2, 0.4, 0.8, 1, 1 s; what may not be sent twice was not carried out."""
    driver = Driver(url, busy_retries=6)
    batch = driver.ask(pdu.Diagnostics(0, b"\0\1"))
    for code in (6, 5, 6, 5, 6, 5, 6):
        driver.come(reply(driver, f"88 {code:02X}"))
        driver.wait(1)
    assert kinds(batch) == [ServerDeviceBusy]
    assert driver.times[1] == pytest.approx(0.1)
    assert driver.times[2] == pytest.approx(1.2)
    assert driver.times[5] == pytest.approx(5)
    assert len(driver.sent) == 7
    assert driver.statistics.exceptions == 7
    assert driver.statistics.retries == 6


@BOTH
def test_nothing_overtakes_a_repetition_with_one_in_flight(url: str) -> None:
    driver = Driver(url, timeout=1, retries=1, busy_retries=1)
    batch = driver.ask(10, 11, 12)
    driver.come(refusal(driver, 6))
    assert addresses(driver) == [10]
    driver.wait(0.1)
    driver.come(answer(driver))
    driver.wait_for(4)
    assert addresses(driver) == [10, 10, 11, 11]
    driver.come(answer(driver))
    driver.wait_for(5)  # on a line the answer is held: another one may follow
    driver.come(answer(driver))
    assert batch.outcomes == [[10], [11], [12]]
    assert addresses(driver) == [10, 10, 11, 11, 12]
    assert driver.is_at_rest


def test_a_repetition_keeps_its_place_among_those_in_flight() -> None:
    driver = Driver(busy_retries=1, max_in_flight=2)
    batch = driver.ask(*range(4), one_by_one=False)
    driver.come(refusal(driver, 6, 0))
    assert addresses(driver) == [0, 1]
    driver.come(answer(driver, 1))
    assert addresses(driver) == [0, 1, 2]
    driver.wait(0.1)
    assert addresses(driver) == [0, 1, 2, 0]
    driver.come(answer(driver, 2), answer(driver, 3))
    driver.come(answer(driver))
    assert batch.outcomes == [[0], [1], [2], [3]]


def test_nothing_more_of_a_batch_is_sent_once_a_refusal_was_received() -> None:
    driver = Driver(max_in_flight=2)
    batch = driver.ask(*range(9), one_by_one=False)
    driver.come(refusal(driver, 2, 0))
    assert addresses(driver) == [0, 1]
    assert kinds(batch)[0] is IllegalDataAddress
    assert driver.is_at_rest


def test_requests_after_a_failure_are_not_repeated() -> None:
    driver = Driver(retries=5, busy_retries=5)
    batch = driver.ask(0, 1, 2, one_by_one=False)
    driver.come(refusal(driver, 6, 2), refusal(driver, 2, 1))
    driver.wait(0.5)
    assert addresses(driver) == [0, 1, 2]
    driver.come(answer(driver, 0))
    assert kinds(batch)[:2] == [[0], IllegalDataAddress]
    assert driver.is_at_rest


@BOTH
def test_other_units_are_asked_during_a_pause(url: str) -> None:
    driver = Driver(url, busy_retries=1)
    busy = driver.ask(1)
    driver.come(refusal(driver, 6))
    exchange(driver, 2, unit=2)
    driver.wait(0.1)
    driver.come(answer(driver))
    assert busy.outcomes == [[1]]


def test_a_repetition_over_a_new_connection_waits_for_it_no_longer_than_a_timeout() -> None:
    driver = Driver(timeout=1, retries=1)
    batch = driver.ask(1)
    driver.lose()
    assert driver.connection.is_wanted
    driver.wait(1)
    assert kinds(batch) == [ModbusConnectionError]
    assert "no connection" in str(batch.outcomes[0])
    assert not driver.connection.is_wanted


@BOTH
def test_a_cancelled_repetition_is_forgotten(url: str) -> None:
    driver = Driver(url, busy_retries=1)
    batch = driver.ask(1)
    driver.come(refusal(driver, 6))
    assert driver.connection.is_wanted
    driver.cancel(batch)
    assert driver.is_at_rest
    driver.wait(5)
    assert len(driver.sent) == 1
    assert driver.is_at_rest
