"""Each row of the table at the head of `line.py`, by bytes and times, and where rows meet."""

import pytest

from libmodbus_py import (
    FrameError,
    InvalidResponse,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    pdu,
)
from libmodbus_py.client.call import Batch
from tests.support.cases import each_case
from tests.support.driver import LINE, TCP, Driver, kinds, rtu, value
from tests.support.replies import answer, exchange, time_out

WRITE = pdu.WriteRegister(1, 2)


# A unit in DOUBT is silent for twice its slowest answer.
SILENCE = 0.02


def usual(driver: Driver, number: int, unit: int = 1) -> None:
    """A request whose answer takes 10 ms: HOLD lasts 20 ms then."""
    exchange(driver, number, unit=unit, after=0.01)


def hold(driver: Driver, batch: Batch, number: int, seconds: float = 0.02) -> None:
    """Answer a request after 10 ms, and check that its result is held for so long."""
    driver.wait(0.01)
    driver.come(value(number))
    driver.wait(seconds - 0.001)
    assert not batch.is_done
    driver.wait(0.002)
    assert batch.outcomes == [[number]]


def used() -> Driver:
    """Return a line with units 1 and 2, which have answered well."""
    driver = Driver(LINE, timeout=1)
    for unit in (1, 2):
        usual(driver, 10 + unit, unit)
    driver.wait(0.1)
    driver.forget()
    return driver


def in_doubt() -> Driver:
    """Return a line whose unit 1 has not answered a read of register 5, two seconds ago."""
    driver = used()
    time_out(driver, 5)
    driver.wait(1)
    return driver


def test_idle_and_a_request_asked_at_once_or_after_two_slowest_answers_of_silence() -> None:
    driver = used()
    begun_at = driver.now
    time_out(driver, 5)
    assert driver.times == [begun_at]
    silent_from = driver.now
    driver.ask(6)
    driver.wait_for(2)
    assert driver.times[1] == pytest.approx(silent_from + SILENCE)


def test_a_unit_that_has_never_answered_is_silent_for_one_timeout() -> None:
    driver = Driver(LINE, timeout=1)
    time_out(driver, 5)
    driver.ask(6)
    driver.wait_for(2)
    assert driver.times == pytest.approx([0, 2])


@pytest.mark.parametrize("unit", [1, 2, 3])
def test_a_frame_while_idle_is_counted_and_leads_to_doubt(unit: int) -> None:
    driver = used()
    driver.come(value(7, unit=unit))
    assert driver.statistics.late_answers == 1
    came_at, batch = driver.now, driver.ask(6, unit=unit)
    driver.wait_for(1)
    assert driver.times == pytest.approx([came_at + (SILENCE if unit < 3 else 0)])  # 3 owes nothing
    driver.wait(0.01)
    driver.come(value(6, unit=unit))
    assert not batch.is_done
    driver.wait(0.02)
    assert batch.outcomes == [[6]]


def test_asked_and_its_answer_is_the_result_at_once() -> None:
    driver = used()
    for number in range(20, 40):
        usual(driver, number)


def test_asked_in_doubt_and_its_answer_is_held() -> None:
    driver = in_doubt()
    hold(driver, driver.ask(6), 6)


def repeating() -> Driver:
    """Return a line whose unit 1 has answered one request twice, and then others."""
    driver = used()
    usual(driver, 1)
    driver.come(value(1))
    driver.wait(1)
    hold(driver, driver.ask(2), 2)
    for number in range(100, 120):
        driver.wait(1)  # the time until the next check doubles each time
        usual(driver, number)
    return driver


def test_asked_and_an_answer_equal_to_that_of_another_request_is_held_where_one_came_twice():
    for driver, is_held in ((used(), False), (repeating(), True)):
        for number in range(20, 60):
            usual(driver, number)
        batch = driver.ask(1)
        driver.wait(0.01)
        driver.come(value(20))
        assert batch.is_done is not is_held
        driver.wait(0.02)
        assert batch.outcomes == [[20]]
        # Not if it is equal to the last one to the same request too, nor to one of another unit.
        exchange(driver, 1, 20, after=0.01)
        exchange(driver, 3, 27, unit=2, after=0.01)


def test_asked_and_a_write_of_another_value_to_the_same_cells_is_the_result_at_once() -> None:
    """The answer contains no values; also where answers came twice."""
    driver = repeating()
    write = rtu("01 10 0007 0001")
    for number in (1, 2, 3):
        batch = driver.ask(pdu.WriteRegisters(7, [number]))
        driver.wait(0.01)
        driver.come(write)
        if number == 1:
            driver.come(write)  # the second answer, which has no request
        if number < 3:
            driver.wait(1)
    assert batch.outcomes == [None]


@pytest.mark.parametrize(
    ("seconds", "is_held"), [(0.007, True), (0.008, False), (0.019, False), (0.021, True)]
)
def test_asked_and_an_answer_at_an_unusual_time_is_held(seconds: float, is_held: bool) -> None:
    """Too soon, like a copy that comes during the next request; or too late."""
    driver = used()
    batch = driver.ask(5)
    driver.wait(seconds)
    driver.come(value(5))
    assert batch.is_done is not is_held
    driver.wait(0.05)
    assert batch.outcomes == [[5]]


def test_asked_and_the_first_of_its_length_is_held_if_it_came_sooner_than_all_others() -> None:
    """A refusal, which may be that of the request before."""
    for seconds, is_held in ((0.007, True), (0.008, False)):
        driver = used()
        batch = driver.ask(5)
        driver.wait(seconds)
        driver.come(rtu("01 83 02"))
        assert batch.is_done is not is_held


@pytest.mark.parametrize("data", [value(5)[:-1] + b"\0", rtu("01 03 04 0005 0006"), b""])
def test_asked_and_a_failure_leads_to_doubt(data: bytes) -> None:
    """A damaged answer, one that does not fit, or none."""
    driver = used()
    batch = driver.ask(5)
    driver.come(data)
    while not batch.is_done:
        driver.wait(0.001)
    assert isinstance(batch.outcomes[0], ModbusError)
    failed_at = driver.now
    batch = driver.ask(6)
    driver.wait_for(2)
    assert driver.times[1] == pytest.approx(failed_at + SILENCE, abs=0.002)
    hold(driver, batch, 6)


def test_asked_and_a_cancelled_caller_leads_to_doubt() -> None:
    driver = used()
    driver.cancel(driver.ask(5))
    left_at = driver.now
    batch = driver.ask(6)
    driver.wait_for(2)
    assert driver.times[1] == pytest.approx(left_at + SILENCE)
    hold(driver, batch, 6)


@pytest.mark.parametrize("is_held", [False, True])
@pytest.mark.parametrize("frame", [value(7, unit=2), rtu("01 04 02 0007")])
def test_asked_and_a_frame_of_another_unit_keeps_the_wait(frame: bytes, is_held: bool) -> None:
    driver = in_doubt() if is_held else used()
    batch = driver.ask(5)
    driver.wait(0.01)
    if is_held:
        driver.come(value(5))
    driver.come(frame)
    assert not batch.is_done
    if not is_held:
        driver.come(value(5))
    driver.wait(0.02)
    assert batch.outcomes == [[5]]
    assert driver.statistics.late_answers == 1


def test_hold_and_the_same_answer_begins_again() -> None:
    driver = in_doubt()
    batch = driver.ask(6)
    driver.wait(0.01)
    for _ in range(4):
        driver.come(value(6))
        driver.wait(0.015)
        assert not batch.is_done
    driver.wait(0.006)
    assert batch.outcomes == [[6]]
    assert driver.statistics.late_answers == 3


@pytest.mark.parametrize("frame", [value(7), rtu("01 83 02"), value(7)[:-1] + b"\0"])
def test_hold_and_another_frame_fails_the_request_and_leads_to_doubt(frame: bytes) -> None:
    driver = in_doubt()
    batch = driver.ask(6)
    driver.wait(0.01)
    driver.come(value(6))
    driver.wait(0.01)
    driver.come(frame)
    failed_at = driver.now
    driver.wait(0.1)
    assert isinstance(batch.outcomes[0], InvalidResponse | FrameError)
    assert batch.outcomes[0].received == value(6) + frame
    driver.ask(8)
    driver.wait_for(3)
    assert driver.times[2] >= failed_at + SILENCE
    driver.come(value(8))
    assert driver.connection.in_flight


@pytest.mark.parametrize("noise", [b"\1\3\xff", b"\1\3\3\0"])
def test_hold_and_noise_like_an_answer_does_not_fail_the_request(noise: bytes) -> None:
    driver = in_doubt()
    batch = driver.ask(6)
    driver.wait(0.01)
    driver.come(value(6) + noise)
    driver.wait(0.05)
    assert batch.outcomes == [[6]]


def test_hold_and_an_answer_after_noise_like_its_beginning_is_held_from_its_arrival() -> None:
    driver = in_doubt()
    batch = driver.ask(6)
    driver.wait(0.01)
    driver.come(b"\1\3\x20" + value(6) + b"\xff")
    driver.wait(1)
    assert batch.outcomes == [[6]]


def test_hold_of_twice_the_slowest_answer_of_this_length_ends_the_doubt() -> None:
    driver = used()
    slow = driver.ask(pdu.ReadHoldingRegisters(5, 2))
    driver.wait(0.4)
    driver.come(rtu("01 03 04 0005 0006"))
    driver.wait(0.6)
    assert slow.outcomes == [[5, 6]]
    driver.wait(1)  # a pause of twice the slowest answer proves nothing here
    driver.ask(5)
    driver.wait(2)
    hold(driver, driver.ask(6), 6)  # the slowest of this length took 10 ms
    usual(driver, 7)
    driver.ask(8)
    driver.wait(2)
    batch = driver.ask(pdu.ReadHoldingRegisters(9, 2))
    driver.come(rtu("01 03 04 0009 000A"))
    driver.wait(0.7)
    assert not batch.is_done
    driver.wait(0.11)
    assert batch.outcomes == [[9, 10]]


@pytest.mark.parametrize("is_own", [True, False])
def test_hold_in_doubt_and_the_end_of_the_time(is_own: bool) -> None:
    """The answer took 0.6 s, and HOLD would last for 1.2 s."""
    driver = Driver(LINE, timeout=1, retries=int(is_own))
    batch = driver.ask(5)
    driver.wait(2)
    if not is_own:
        batch = driver.ask(6)
    driver.wait(0.6)
    driver.come(value(6))
    driver.wait(0.39)
    assert not batch.is_done
    driver.wait(0.01)
    if is_own:
        assert batch.outcomes == [[6]]  # the answer to either of its frames
    else:
        assert kinds(batch) == [ModbusTimeoutError]
        assert "or an earlier one" in str(batch.outcomes[0])
        failed_at = driver.now
        driver.ask(7)
        driver.wait_for(3)
        assert driver.times[2] == pytest.approx(failed_at + 1)
        driver.wait(0.6)
        driver.come(value(7))
    assert not driver.connection.in_flight  # the silence has ended the doubt


def test_hold_without_doubt_and_the_end_of_the_time() -> None:
    driver = used()
    batch = driver.ask(20)
    driver.wait(0.9)
    hold(driver, batch, 20, seconds=0.09)


def test_doubt_and_a_frame_of_the_unit_restarts_the_silence() -> None:
    driver = used()
    time_out(driver, 5)
    driver.ask(6)
    for _ in range(2):
        driver.wait(0.015)
        driver.come(value(5))
    heard_at = driver.now
    driver.wait_for(2)
    assert driver.times[1] == pytest.approx(heard_at + SILENCE)
    assert driver.statistics.late_answers == 2


@each_case("data", ["01 03", "01 83", "01", "FF 01 03 02", "09 03 02 00 01"])
def test_doubt_and_the_beginning_of_an_answer_restarts_the_silence(data: str) -> None:
    driver = used()
    time_out(driver, 5)
    driver.ask(6)
    driver.wait(0.015)
    driver.come(bytes.fromhex(data))
    heard_at = driver.now
    driver.wait_for(2)
    assert driver.times[1] == pytest.approx(heard_at + SILENCE)


@each_case("data", ["55", "FF FF FF", "02 03 02 00", "09 03 00 00 00 02", "01 04 02", "03"])
def test_doubt_and_bytes_of_other_units_do_not_restart_the_silence(data: str) -> None:
    driver = used()
    time_out(driver, 5)
    silent_from = driver.now
    driver.ask(6)
    for _ in range(2):
        driver.wait(0.01)
        driver.come(bytes.fromhex(data), value(7, unit=9))
    driver.wait_for(2)
    assert driver.times[1] == pytest.approx(silent_from + SILENCE)


def test_doubt_and_a_late_frame_of_its_unit_restarts_the_silence() -> None:
    """The unit still works through earlier requests, also those of other functions."""
    driver = used()
    driver.ask(pdu.ReadInputRegisters(5, 1))
    driver.wait(1)
    driver.ask(5)
    driver.wait(1)
    silent_from = driver.now
    driver.ask(6)
    driver.wait(0.015)
    driver.come(rtu("01 04 02 00 05"))
    assert driver.now < silent_from + SILENCE
    heard_at = driver.now
    driver.wait_for(3)
    assert driver.times[2] == pytest.approx(heard_at + SILENCE)


def test_hold_and_a_late_frame_of_the_unit_begins_again() -> None:
    driver = used()
    driver.ask(pdu.ReadInputRegisters(5, 1))
    driver.wait(1)
    driver.ask(5)
    driver.wait(2)
    batch = driver.ask(6)
    for frame in (value(6), *[rtu("01 04 02 00 05")] * 3):
        driver.come(frame)
        driver.wait(0.015)
        assert not batch.is_done
    driver.wait(0.006)
    assert batch.outcomes == [[6]]


def test_an_answer_is_held_once_in_ten_timeouts() -> None:
    """Without a pause on the line: it could be shifted by one request, and nothing else tells."""
    driver, count = used(), 0
    for number in range(100, 2300):
        batch = driver.ask(number)
        driver.wait(0.01)
        driver.come(value(number))
        count += not batch.is_done
        driver.wait(0 if batch.is_done else 0.02)
        assert batch.outcomes == [[number]]
    assert count == 2


@each_case(("frame", "is_first"), [
    (value(6), True), (value(6), False), (value(7), True), (value(7), False),
])  # fmt: skip
def test_a_frame_exactly_at_the_end_of_hold(frame: bytes, is_first: bool) -> None:
    """Bytes read before the alarm are in HOLD, bytes read later are not."""
    driver = in_doubt()
    batch = driver.ask(6)
    driver.come(value(6))
    driver.now += 0.02
    if is_first:
        driver.come(frame)
        assert batch.is_done == (frame != value(6))
    driver.wait(0.02)
    if not is_first:
        assert batch.outcomes == [[6]]
        driver.come(frame)
    assert kinds(batch) == ([[6]] if frame == value(6) or not is_first else [InvalidResponse])
    assert driver.statistics.late_answers == 1
    assert driver.is_at_rest


def test_doubt_continues_over_another_connection() -> None:
    """The unit is behind the server: its late answer may come over the next connection, too."""
    driver = used()
    first = driver.ask(5)
    driver.wait(0.3)
    driver.reconnect(by_itself=False)
    assert kinds(first) == [ModbusConnectionError]
    lost_at, batch = driver.now, driver.ask(6)
    driver.wait(0.015)
    driver.come(value(5))
    driver.wait(0.015)
    assert len(driver.sent) == 1
    driver.wait_for(2)
    assert driver.times[1] == pytest.approx(lost_at + 0.015 + SILENCE)
    hold(driver, batch, 6)


def test_a_connection_that_ends_during_hold_fails_the_request() -> None:
    driver = in_doubt()
    batch = driver.ask(6)
    driver.come(value(6))
    driver.reconnect()
    assert kinds(batch) == [ModbusConnectionError]
    driver.come(value(6))
    driver.wait(5)
    assert kinds(batch) == [ModbusConnectionError]
    assert driver.is_at_rest


def test_hold_without_doubt_and_the_other_side_ends_the_connection() -> None:
    driver = Driver(LINE, timeout=1, is_new=True)
    for number in range(5, 8):
        batch = driver.ask(number)
        driver.come(value(number))
        assert not batch.is_done
        driver.reconnect()
        assert batch.outcomes == [[number]]
    batch = driver.ask(8)
    driver.come(value(8) + value(9)[:5])
    driver.reconnect()
    assert kinds(batch) == [ModbusConnectionError]


def test_the_end_of_a_connection_in_hold_ends_the_doubt_if_silence_follows() -> None:
    driver = in_doubt()
    batches = []
    for number in (6, 7):
        batches.append(driver.ask(number))
        driver.wait(0.5)
        driver.come(value(number))
        driver.reconnect()
    assert kinds(batches[0]) == [ModbusConnectionError]
    assert batches[1].outcomes == [[7]]


def test_a_caller_that_is_cancelled_during_hold_leaves_doubt() -> None:
    driver = in_doubt()
    batch = driver.ask(6)
    driver.come(value(6))
    driver.cancel(batch)
    left_at, other = driver.now, driver.ask(8)
    driver.wait_for(3)
    assert driver.times[2] == pytest.approx(left_at + SILENCE)
    hold(driver, other, 8)


@each_case("timeout", [0.001, 0.5, 86_400])
def test_a_timeout_that_is_changed_ends_each_wait(timeout: float) -> None:
    """In DOUBT, ASKED and HOLD; no wait becomes infinite."""
    driver = used()
    driver.ask(5)
    driver.wait(1)
    batches = [driver.ask(6), driver.ask(7)]
    driver.timeouts.timeout = timeout
    driver.matching.wake(driver.now)
    driver.wait_for(2)
    driver.come(value(6))
    driver.wait(max(3, 5 * timeout))
    driver.come(value(7))
    driver.wait(max(3, 5 * timeout))
    assert all(batch.is_done for batch in batches)
    assert driver.is_at_rest


@each_case("url", [LINE, TCP])
def test_a_clock_that_stands_still_makes_no_wait_infinite(url: str) -> None:
    """Requests, answers and frames without a request, all at one time."""
    driver = Driver(url, timeout=1)
    for number in range(50):
        exchange(driver, number)
        driver.wait(0)
    driver.come(answer(driver, 0), answer(driver, 0))
    batch = driver.ask(3)
    driver.wait(0)
    driver.come(answer(driver))
    driver.wait(0)
    assert batch.outcomes == [[3]]


@each_case(("data", "late"), [(b"", 0), (value(1), 1), (value(1) + value(1), 2)])
def test_frames_after_the_answer_are_counted_as_late(data: bytes, late: int) -> None:
    driver = Driver(LINE, timeout=1)
    batch = driver.ask(1)
    driver.come(value(1) + data)
    assert batch.outcomes == [[1]]
    assert driver.statistics.late_answers == late


def test_a_shift_that_begins_with_a_slow_answer_ends_with_the_next_one() -> None:
    """A duplicate comes so late that its HOLD is cut short by the end of the request in flight."""
    driver = used()
    late = driver.ask(5)
    driver.wait(0.98)
    driver.come(value(4))  # of a request long ago
    driver.wait(0.03)
    assert late.outcomes == [[4]]  # without the limit HOLD would take until 1.96 s
    behind = driver.ask(6)
    driver.wait(0.01)
    driver.come(value(5))  # each answer comes one request too late
    driver.wait(0.01)
    driver.come(value(6))
    assert kinds(behind) == [InvalidResponse]
