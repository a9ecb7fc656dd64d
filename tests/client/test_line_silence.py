"""How long a line is silent after a failure, and which received bytes are kept meanwhile."""

import math

import pytest

from libmodbus_py import InvalidResponse, ModbusError, ModbusTimeoutError, pdu
from libmodbus_py.ports.trace import TracedFrame
from tests.support.cases import each_case
from tests.support.driver import LINE, Driver, kinds, small_memory, value
from tests.support.replies import exchange, time_out


def units(driver: Driver) -> list[int]:
    """Return the units that were asked."""
    return [adu[0] for adu in driver.sent]


def learnt(*unit: int) -> Driver:
    """Return a line whose units have answered at once: HOLD is as short as can be."""
    driver = Driver(LINE, timeout=1)
    for entry in unit:
        exchange(driver, 1, unit=entry)
    driver.forget()
    return driver


def test_a_late_answer_during_a_request_to_another_unit_restarts_the_silence() -> None:
    driver = learnt(1, 2)
    time_out(driver, 0, unit=1)
    other = driver.ask(6, unit=2)
    driver.wait_until(1.5)
    driver.come(value(0, unit=1))
    driver.come(value(6, unit=2))
    driver.wait(0.5)  # the answer took so long that it is held
    assert other.outcomes == [[6]]
    again = driver.ask(7, unit=1)
    driver.wait_until(2.4)
    assert units(driver) == [1, 2]
    driver.wait_until(2.5)
    driver.come(value(7, unit=1))
    driver.wait(0)
    assert again.outcomes == [[7]]
    assert driver.statistics.late_answers == 1


def test_the_silence_is_as_long_as_the_timeout_of_the_request_that_failed() -> None:
    driver = Driver(LINE, timeout=5)
    driver.ask(5, timeout=0.3)
    driver.wait(0.3)
    driver.ask(6)
    driver.wait(0.3)
    assert driver.times == pytest.approx([0, 0.6])


def send_slowly(driver: Driver, data: bytes, seconds: float) -> None:
    """Bytes every 100 ms."""
    for _ in range(round(seconds * 10)):
        driver.come(data)
        driver.wait(0.1)


@pytest.mark.parametrize("data", [b"\x01", b"\x01\x03" * 50])
def test_a_unit_that_never_becomes_silent_is_asked_after_one_timeout(data: bytes) -> None:
    driver = Driver(LINE, timeout=1)
    time_out(driver, 0)
    batch = driver.ask(6)
    send_slowly(driver, data, 0.9)
    assert len(driver.sent) == 1
    send_slowly(driver, data, 0.2)
    assert len(driver.sent) == 2
    driver.wait(1)
    assert batch.is_done


def test_a_request_sent_without_silence_has_its_answer_held() -> None:
    driver = learnt(1)
    time_out(driver, 0)
    for frame, result in ((value(0), InvalidResponse), (b"", [7])):
        batch = driver.ask(7)
        send_slowly(driver, value(0)[:2], 1.0)
        driver.wait(0.2)
        driver.come(frame or value(7))
        driver.wait(0.1)
        assert not batch.is_done
        driver.come(frame and value(7))
        driver.wait(0.4)
        assert kinds(batch) == [result]


def test_a_repetition_does_not_wait_for_ever_for_silence() -> None:
    driver = Driver(LINE, timeout=1, retries=1)
    batch = driver.ask(6)
    driver.wait(1)
    send_slowly(driver, b"\x01", 2.2)
    assert isinstance(batch.outcomes[0], ModbusError)
    assert driver.is_at_rest


def test_a_cancelled_caller_does_not_shorten_the_wait_of_the_next() -> None:
    driver = learnt(1)
    time_out(driver, 0)
    leaving = driver.ask(6)
    send_slowly(driver, b"\x01", 0.5)
    driver.cancel(leaving)
    driver.ask(7)
    send_slowly(driver, b"\x01", 0.9)
    assert len(driver.sent) == 1


@each_case("others", [(0.05, 0.3), (0.3, 0.1), (1.0, 1.0)])
def test_one_lost_answer_on_a_busy_line_costs_one_timeout(others: tuple[float, float]) -> None:
    """Another master polls unit 9, and stray bytes come: unit 1 is asked again, and answers."""
    frames, strays = others
    driver = Driver(LINE, timeout=1)
    events = [(at * frames, value(7, unit=9)) for at in range(1, 20)]
    events += [(at * strays, b"\xff") for at in range(1, 20)]

    def pass_until(at: float) -> None:
        while events and min(events)[0] <= at:
            event = min(events)
            events.remove(event)
            driver.wait_until(event[0])
            driver.come(event[1])
        driver.wait_until(at)

    exchange(driver, 1, after=0.01)
    driver.ask(2)
    pass_until(1.01)
    batch = driver.ask(3)
    pass_until(1.05)
    assert len(driver.sent) == 3
    driver.come(value(3))
    pass_until(1.15)
    assert batch.outcomes == [[3]]


def test_no_alarm_is_in_the_past_after_half_an_answer() -> None:
    """An alarm that lay in the past would have an event loop spin."""
    for end in ("timeout", "cancelled", "lost"):
        driver = Driver("rtu+tcp://192.0.2.1", timeout=1)
        batch = driver.ask(1)
        driver.wait(0.99)
        driver.come(value(1)[:4])
        if end == "timeout":
            driver.wait(0.01)
        elif end == "cancelled":
            driver.cancel(batch)
        else:
            driver.lose()
        driver.wait(5)
        assert batch.is_done
        assert driver.matching.alarm == math.inf, end


def test_only_the_unit_that_owes_an_answer_is_left_alone() -> None:
    driver = Driver(LINE, timeout=0.1)
    driver.ask(1, unit=7)
    driver.wait(0.1)
    assert driver.matching.ready_at(7) == driver.matching.ready_at(7, 3) == 0.2
    assert driver.matching.ready_at(7, 4) == driver.matching.ready_at(8) == 0.0
    assert driver.matching.ready_at(0) == 0.0  # a broadcast has no answer
    exchange(driver, 2, unit=8)


def test_an_answer_is_a_sign_of_life_on_lines_over_networks() -> None:
    driver = Driver("rtu+tcp://192.0.2.1", timeout=1)
    for number in range(8):
        batch = driver.ask(number)
        driver.wait_for(number + 1)
        if number % 3 == 0:
            driver.come(value(number))
            driver.wait(0)
            assert batch.outcomes == [[number]]
        else:
            driver.wait(1)
            assert kinds(batch) == [ModbusTimeoutError]
        assert driver.connection.broken is None
    assert driver.statistics.connects == 1


def test_a_broadcast_waits_for_the_calls_before_it_and_for_no_doubt() -> None:
    """Unit 1 owes an answer: a broadcast goes at once, but not before a request to unit 1."""
    driver = Driver(LINE, timeout=1, turnaround=0.1)
    driver.ask(1, unit=1)
    driver.wait(1.0)
    driver.ask(pdu.WriteRegister(1, 1), unit=0, is_broadcast=True)
    assert units(driver) == [1, 0]
    driver.ask(2, unit=1)
    driver.ask(pdu.WriteRegister(1, 2), unit=0, is_broadcast=True)
    driver.ask(1, unit=5)
    driver.wait(0.9)
    assert len(driver.sent) == 2
    driver.wait(0.1)
    driver.wait(1.0)
    assert units(driver) == [1, 0, 1, 0]
    driver.wait(0.1)
    assert units(driver) == [1, 0, 1, 0, 5]


@pytest.mark.parametrize("half", ["01 03 FA 00", "01", "01 83", "01 03 02 00 07 00"])
def test_the_first_half_of_a_frame_is_not_joined_to_the_next_answer(half: str) -> None:
    driver = Driver(LINE, timeout=1)
    driver.ask(1)
    driver.come(bytes.fromhex(half))
    driver.wait(1.0)
    batch = driver.ask(2)
    driver.wait(1.5)
    assert len(driver.sent) == 2
    driver.come(value(2))
    driver.wait(1)  # unit 1 owes another answer, so this one is not accepted
    assert kinds(batch) == [ModbusTimeoutError]
    exchange(driver, 2, after=1)


def test_the_first_600_bytes_of_a_flood_are_kept() -> None:
    """Of the bytes received in place of an answer."""
    pieces = [bytes([0x80 + number]) * 250 for number in range(8)]
    start = b"".join(pieces)[:600]
    driver = Driver(LINE, timeout=1)
    first = driver.ask(1)
    driver.come(*pieces)
    driver.wait(1)
    assert first.outcomes[0].received == start
    second = driver.ask(2)
    driver.come(*pieces)
    driver.wait_for(2)
    driver.come(*pieces)
    driver.wait(1)
    assert second.outcomes[0].received == start


def test_a_late_answer_in_pieces_counts_once_and_each_piece_delays_the_next_request() -> None:
    driver = Driver(LINE, timeout=1)
    exchange(driver, 1, after=0.01)
    driver.forget()
    time_out(driver, 0)
    batch = driver.ask(6)
    for piece in (value(5)[:3], value(5)[3:]):
        driver.wait(0.015)
        driver.come(piece)
    assert driver.statistics.late_answers == 1
    late_at = driver.now
    driver.wait_for(2)
    assert driver.times[1] == pytest.approx(late_at + 0.02)
    driver.wait(0.01)
    driver.come(value(6))
    driver.wait(0.02)
    assert batch.outcomes == [[6]]


def test_a_flood_on_an_idle_line_is_dropped_by_the_next_request() -> None:
    driver = Driver(LINE)
    with small_memory():
        driver.come(bytes(0x10000))
    assert not driver.connection.is_flooded
    driver.come(b"\0")
    assert driver.connection.is_flooded
    with small_memory():
        for _ in range(100):
            driver.come(bytes(0x1000))
    assert driver.connection.broken is None  # a port is not opened anew for that
    exchange(driver, 1, after=0.03)  # the line must have been quiet for a moment
    assert not driver.connection.is_flooded


@pytest.mark.parametrize(
    "late",
    [value(1), b"\xfe\x01", value(1)[:4], value(1) + b"\x01\x03", b"\x01" + value(1)],
    ids=["an answer", "noise", "half an answer", "an answer and more", "noise and an answer"],
)
def test_unrequested_frames_are_traced(late: bytes) -> None:
    events: list[TracedFrame] = []
    driver = Driver(LINE, timeout=1, trace=events.append)
    time_out(driver, 0)
    driver.come(late)
    driver.wait(1)
    driver.ask(1)  # what is no frame is traced before the next request
    receipts = [event for event in events if event.direction == "received"]
    assert b"".join(receipt.adu for receipt in receipts) == late
    frames = [(receipt.unit, receipt.function) for receipt in receipts if receipt.unit is not None]
    assert frames == ([(1, 3)] if value(1) in late else [])
