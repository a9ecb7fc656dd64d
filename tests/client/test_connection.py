"""Timeouts, pauses, broadcasts, and connections that die and are made again, in bytes and times."""

import pytest

from libmodbus_py import ModbusConnectionError, ModbusTimeoutError, pdu
from libmodbus_py.client.call import NOT_ASKED
from tests.support.driver import LINE, LOST, TCP, Driver, kinds, tcp
from tests.support.replies import BOTH, addresses, answer, refusal, time_out


@BOTH
def test_a_request_fails_exactly_at_the_end_of_its_timeout(url: str) -> None:
    driver = Driver(url, timeout=1)
    batch = driver.ask(5)
    driver.wait(0.999)
    assert not batch.is_done
    driver.wait(0.001)
    assert kinds(batch) == [ModbusTimeoutError]
    error = batch.outcomes[0]
    assert (error.unit, error.function, error.sent) == (1, 3, driver.sent[0])
    assert "no answer within 1 s" in str(error)
    assert driver.statistics.timeouts == 1
    assert driver.is_at_rest


def test_the_time_of_other_requests_does_not_count() -> None:
    driver = Driver(LINE, timeout=1)
    batches = [driver.ask(number) for number in range(5)]
    for _ in range(5):
        driver.wait(0.9)
        driver.come(answer(driver))
    assert [batch.outcomes for batch in batches] == [[[number]] for number in range(5)]


@BOTH
def test_the_time_of_connecting_counts(url: str) -> None:
    driver = Driver(url, timeout=1, is_open=False)
    batch = driver.ask(1, 2)
    driver.life.connecting()
    driver.wait(0.7)
    driver.connection.opened(driver.now)
    driver.start()
    driver.wait(0.29)
    assert not batch.is_done
    driver.wait(0.01)
    assert kinds(batch)[0] is ModbusTimeoutError


def test_a_request_waits_for_a_connection_no_longer_than_its_timeout() -> None:
    driver = Driver(timeout=1, is_open=False)
    short, batch, joining = driver.ask(1, timeout=0.5), driver.ask(2, 3, go_on=True), driver.join()
    driver.life.connecting()
    driver.wait(0.5)
    assert "no connection to 192.0.2.1:502 within 0.5 s" in str(short.outcomes[0])
    assert not batch.is_done
    driver.wait(0.5)
    assert kinds(batch) == [ModbusConnectionError] * 2
    assert batch.outcomes[1].asked == "ReadHoldingRegisters(address=3, count=1)"
    assert joining.is_done
    assert "within 1 s" in str(joining.outcome)
    assert driver.is_at_rest


def test_after_three_timeouts_in_a_row_the_next_request_goes_over_a_new_connection() -> None:
    driver = Driver(timeout=1)
    for _ in range(3):
        assert driver.connection.broken is None
        time_out(driver)
    batch = driver.ask(7)
    assert len(driver.sent) == 3
    driver.replace_broken()
    driver.come(answer(driver))
    assert batch.outcomes == [[7]]
    assert driver.statistics.lost == 1


def test_a_host_that_never_answers_is_asked_over_and_over() -> None:
    """Polls of a dead device behind a gateway succeed as soon as the device is back."""
    driver = Driver(timeout=1)
    for _ in range(20):
        batch = driver.ask(1)
        if driver.connection.broken:
            driver.leave_broken()
            assert driver.connection.is_wanted
            driver.open()
        driver.wait(1)
        assert kinds(batch) == [ModbusTimeoutError]
    assert len(driver.sent) == 20
    assert driver.statistics.connects == 7


def test_cancelled_requests_count_as_unanswered() -> None:
    driver = Driver(timeout=1)
    for _ in range(3):
        batch = driver.ask(1)
        driver.wait(0.2)
        driver.cancel(batch)
    driver.ask(1)
    assert driver.connection.broken is not None


@pytest.mark.parametrize("life", ["its answer", "another's answer", "a refusal"])
def test_any_received_frame_starts_the_count_anew(life: str) -> None:
    driver = Driver(timeout=1)
    for _ in range(2):
        time_out(driver)
    if life == "another's answer":
        driver.ask(2, unit=9)
        driver.come(answer(driver))
    else:
        driver.ask(2)
        driver.come(answer(driver) if life == "its answer" else refusal(driver, 2))
    for _ in range(2):
        time_out(driver)
    driver.ask(1)
    assert driver.connection.broken is None


def test_a_device_that_stays_one_answer_behind_gets_a_new_connection() -> None:
    driver = Driver(timeout=1)
    for number in range(4):
        batch = driver.ask(1)
        if number == 3:
            driver.replace_broken()
        if number:
            driver.come(answer(driver, number - 1))
        driver.wait(1)
    assert "but that to an earlier request; a longer timeout=?" in str(batch.outcomes[0])


def test_an_answer_with_an_unknown_id_does_not_count_as_received() -> None:
    driver = Driver(timeout=1)
    for _ in range(3):
        driver.ask(1)
        driver.come(tcp(driver.sent[-1], number=999))
        driver.wait(1)
    driver.ask(1)
    assert driver.connection.broken is not None


def test_requests_that_were_sent_before_the_last_answer_do_not_count() -> None:
    driver = Driver(timeout=1)
    for _ in range(5):
        driver.ask(1)
    driver.wait(0.5)
    driver.ask(2)
    driver.come(answer(driver))
    driver.wait(0.5)
    driver.ask(3)
    assert driver.connection.broken is None


def test_a_serial_port_never_counts_as_dead() -> None:
    driver = Driver(LINE, timeout=0.1)
    for _ in range(10):
        driver.ask(1)
        driver.wait(0.3)
    assert len(driver.sent) == 10


@BOTH
def test_what_is_in_flight_fails_and_the_queue_waits_for_the_next_connection(url: str) -> None:
    driver = Driver(url, timeout=1, **({"max_in_flight": 2} if url == TCP else {}))
    batches = [driver.ask(number) for number in range(4)]
    in_flight = len(driver.sent)
    driver.lose()
    assert [batch.is_done for batch in batches] == [number < in_flight for number in range(4)]
    assert batches[0].outcomes[0].errno == 104
    assert batches[0].outcomes[0].sent == driver.sent[0]
    assert driver.connection.is_wanted
    driver.open()
    driver.wait(1)
    assert set(addresses(driver)) >= {0, 3} if url == TCP else True
    assert driver.statistics.lost == 1


def test_every_request_has_an_error_of_its_own() -> None:
    driver = Driver()
    batch = driver.ask(1, 2, 3, one_by_one=False, go_on=True)
    driver.lose()
    assert len({id(outcome) for outcome in batch.outcomes}) == 3
    assert [outcome.sent for outcome in batch.outcomes] == driver.sent
    assert LOST.sent == b""


def test_a_batch_that_has_ended_opens_no_connection() -> None:
    driver = Driver()
    batch = driver.ask(1, 2)
    driver.lose()
    assert kinds(batch) == [ModbusConnectionError, NOT_ASKED]
    assert not driver.connection.is_wanted
    driver = Driver(is_open=False)
    driver.cancel(driver.ask(1))
    assert not driver.connection.is_wanted


def test_three_connections_without_an_answer_fail_all_waiting_requests() -> None:
    driver = Driver(max_in_flight=1)
    batch = driver.ask(*range(10), go_on=True)
    for number in range(3):
        assert len(driver.sent) == number + 1
        driver.lose()
        if not batch.is_done:
            driver.open()
    assert kinds(batch) == [ModbusConnectionError] * 10
    assert [outcome.sent != b"" for outcome in batch.outcomes] == [True] * 3 + [False] * 7
    assert driver.is_at_rest


def test_an_answer_before_a_connection_ends_keeps_waiting_requests() -> None:
    driver = Driver(max_in_flight=1)
    batch = driver.ask(*range(10), go_on=True)
    for _ in range(10):
        driver.come(answer(driver))
        driver.lose()
        driver.open()
    assert batch.outcomes == [[number] for number in range(10)]
    assert len(driver.sent) == 10 + 9  # each but the first was cut off, and sent once more


def test_waiting_requests_share_one_attempt_and_its_failure() -> None:
    driver = Driver(is_open=False)
    batches = [driver.ask(number) for number in range(3)]
    joining, leaving = driver.join(), driver.join()
    driver.connection.withdraw(leaving, driver.now)
    driver.fail()
    assert [kinds(batch) for batch in batches] == [[ModbusConnectionError]] * 3
    assert {batch.outcomes[0].errno for batch in batches} == {111}
    assert isinstance(joining.outcome, ModbusConnectionError)
    assert (joining.outcome.unit, joining.outcome.errno) == (1, 111)
    assert leaving.outcome is NOT_ASKED
    assert driver.is_at_rest
    assert len({id(batch.outcomes[0]) for batch in batches}) == 3


def test_a_broadcast_that_was_cancelled_keeps_its_time_on_the_line() -> None:
    driver = Driver(LINE, turnaround=0.2)
    driver.cancel(driver.ask(pdu.WriteRegister(1, 2), unit=0, is_broadcast=True))
    driver.ask(5)
    driver.wait(0.19)
    assert len(driver.sent) == 1
    driver.wait(0.01)
    assert len(driver.sent) == 2


def test_after_an_unanswered_request_a_batch_is_sent_one_by_one() -> None:
    silent = pdu.Diagnostics(pdu.SubFunction.FORCE_LISTEN_ONLY, b"\0\0")
    driver = Driver(turnaround=0.1)
    batch = driver.ask(1, silent, 2, one_by_one=False)
    assert len(driver.sent) == 1
    driver.come(answer(driver))
    assert len(driver.sent) == 2
    driver.wait(0.1)
    driver.come(answer(driver))
    assert batch.outcomes == [[1], None, [2]]
