"""One request at a time on lines without ids: what is sent when, and what is an answer."""

import pytest

from libmodbus_py import IllegalDataAddress, InvalidResponse, pdu
from tests.support.cases import each_case
from tests.support.driver import LINE, Driver, kinds, rtu, value

WRITE = pdu.WriteRegister(1, 2)


def test_a_request_is_the_frame_of_the_specification() -> None:
    driver = Driver(LINE)
    driver.ask(pdu.ReadHoldingRegisters(0x6B, 3), unit=0x11)
    assert driver.sent == [bytes.fromhex("11 03 006B 0003 7687")]


@pytest.mark.parametrize("size", range(1, 8))
def test_an_answer_may_come_in_any_pieces(size: int) -> None:
    driver = Driver(LINE)
    batch = driver.ask(1)
    data = value(1)
    driver.come(*(data[at : at + size] for at in range(0, len(data), size)))
    assert batch.outcomes == [[1]]


def test_3_5_characters_of_silence_are_kept_before_each_request() -> None:
    """Of 11 bits each: 4.01 ms at 9600 bit/s; and the request itself takes 9.17 ms."""
    driver = Driver("rtu:///dev/nowhere?baudrate=9600")
    for number in range(3):
        driver.ask(number)
    driver.wait(0.02)
    driver.come(value(0))
    assert len(driver.sent) == 1
    driver.wait(38.5 / 9600)
    driver.wait(0.02)
    driver.come(value(1))
    driver.wait(0.02)
    gap = driver.times[1] - 0.02
    assert gap == pytest.approx(38.5 / 9600)
    assert len(driver.sent) == 3


def test_a_broadcast_leaves_the_line_before_the_next_request() -> None:
    """8 bytes of 11 bits at 300 bit/s are on the line for 293 ms, and then come 3.5 more."""
    driver = Driver("rtu:///dev/nowhere?baudrate=300", turnaround=0)
    driver.ask(WRITE, unit=0, is_broadcast=True)
    driver.ask(1)
    driver.wait(1)
    assert driver.times[1] == pytest.approx((88 + 38.5) / 300)


def test_turning_the_line_counts_as_sending() -> None:
    """8 bytes and twice the delay, though the answer came before that on a line without delay."""
    driver = Driver("rtu:///dev/nowhere?baudrate=9600&rs485=rts-up&rts_delay=0.1&silence=0.001")
    driver.ask(1)
    driver.ask(2)
    driver.wait(0.05)
    driver.come(value(1))
    driver.wait(1)
    assert driver.times[1] == pytest.approx(88 / 9600 + 0.2)


@each_case(
    ("frame", "reason"),
    [
        (value(9, unit=9), "unit 9 answered"),
        (rtu("01 04 02 0005"), "function 4 was answered, not 3"),
        (rtu("01 84 02"), "function 4 was answered, not 3"),
    ],
)
def test_an_answer_to_another_request_is_named_in_the_error_at_the_end(frame, reason):
    driver = Driver(LINE, timeout=1)
    batch = driver.ask(5)
    driver.come(frame)
    assert not batch.is_done
    driver.come(value(5))
    assert batch.outcomes == [[5]]
    batch = driver.ask(5)
    driver.come(frame)
    driver.wait(1)
    assert kinds(batch) == [InvalidResponse]
    assert reason in str(batch.outcomes[0])
    assert batch.outcomes[0].answers_another
    assert driver.statistics.late_answers == 2


# Noise before a whole answer, the answer, and noise behind it.
NOISY = [
    ("00", rtu("04 83 02"), "00"),  # minimalmodbus#61
    ("00", rtu("04 03 02 6D60"), "00"),  # eModbus#40
    ("00", rtu("04 03 02 6D60"), ""),  # libmodbus#304
    ("", rtu("04 03 02 6D60"), "00 00 00"),  # home-assistant/core#69742
    ("FF FE", rtu("04 03 02 6D60"), "F0"),
    ("04", rtu("04 03 02 6D60"), "04"),
    ("55 04 03 F0", rtu("04 03 02 6D60"), "00"),  # as if a long answer had begun
    # As before, and the CRC of all these bytes together fits, too.
    ("04 03 F0", rtu("04 03 02 6D60"), "31 66"),
]


@each_case(("before", "frame", "behind"), NOISY)
@each_case("url", [LINE, "rtu+tcp://192.0.2.1"])
def test_an_answer_between_noise_is_found_as_soon_as_the_line_is_silent(before, frame, behind, url):
    driver = Driver(url, timeout=1)
    batch = driver.ask(1, unit=4)
    driver.come(bytes.fromhex(before) + frame + bytes.fromhex(behind))
    # Only where another answer may have begun before it, the end of the time is waited for.
    driver.wait(1 if "04 03 F0" in before else 0.05)
    assert kinds(batch) == [[0x6D60] if frame[1] == 3 else IllegalDataAddress]
