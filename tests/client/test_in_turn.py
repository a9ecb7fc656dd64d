"""
One request at a time on lines without ids, told in bytes and times.
"""

from __future__ import annotations

import pytest

from libmodbus_py import FrameError, IllegalDataAddress, InvalidResponse, ModbusTimeoutError, pdu
from libmodbus_py.ports.trace import Traced
from tests.support.talk import (
    ASCII,
    LINE,
    Talk,
    ascii_frame,
    is_quiet,
    kinds,
    little_kept,
    rtu,
    value,
)

WRITE = pdu.WriteRegister(1, 2)


def units(talk: Talk) -> list[int]:
    """Who was asked."""
    return [adu[0] for adu in talk.sent]


# --- one after the other ---------------------------------------------------------------


def test_a_request_is_the_frame_of_the_specification() -> None:
    talk = Talk(LINE)
    talk.ask(pdu.ReadHoldingRegisters(0x6B, 3), unit=0x11)
    assert talk.sent == [bytes.fromhex("11 03 006B 0003 7687")]


def test_the_next_request_waits_for_the_answer_to_the_last() -> None:
    talk = Talk(LINE)
    first, second = talk.ask(1), talk.ask(2)
    assert len(talk.sent) == 1
    talk.come(value(1))
    talk.come(value(2))
    assert (first.outcomes, second.outcomes) == ([[1]], [[2]])
    assert talk.is_at_rest


@pytest.mark.parametrize("size", range(1, 8))
def test_an_answer_may_come_in_any_pieces(size: int) -> None:
    talk = Talk(LINE)
    batch = talk.ask(1)
    data = value(1)
    talk.come(*(data[at : at + size] for at in range(0, len(data), size)))
    assert batch.outcomes == [[1]]


def test_a_pause_within_an_answer_does_no_harm() -> None:
    talk = Talk(LINE)
    batch = talk.ask(1)
    talk.come(value(1)[:4])
    talk.wait(0.5)
    talk.come(value(1)[4:])
    assert batch.outcomes == [[1]]


def test_3_5_characters_of_silence_are_kept_before_each_request() -> None:
    """Of 11 bits each: 4.01 ms at 9600 bit/s; and the request itself takes 9.17 ms."""
    talk = Talk("rtu:///dev/nowhere?baudrate=9600")
    for number in range(3):
        talk.ask(number)
    talk.wait(0.02)
    talk.come(value(0))
    assert len(talk.sent) == 1
    talk.wait(38.5 / 9600)
    talk.wait(0.02)
    talk.come(value(1))
    talk.wait(0.02)
    gap = talk.times[1] - 0.02
    assert gap == pytest.approx(38.5 / 9600)
    assert len(talk.sent) == 3


def test_a_broadcast_leaves_the_line_before_the_next_request() -> None:
    """8 bytes of 11 bits at 300 bit/s are on the line for 293 ms, and then come 3.5 more."""
    talk = Talk("rtu:///dev/nowhere?baudrate=300", turnaround=0)
    talk.ask(WRITE, unit=0, is_broadcast=True)
    talk.ask(1)
    talk.wait(1)
    assert talk.times[1] == pytest.approx((88 + 38.5) / 300)


def test_turning_the_line_counts_as_sending() -> None:
    """8 bytes and twice the delay, though the answer came before that on a line without delay."""
    talk = Talk("rtu:///dev/nowhere?baudrate=9600&rs485=rts-up&rts_delay=0.1&silence=0.001")
    talk.ask(1)
    talk.ask(2)
    talk.wait(0.05)
    talk.come(value(1))
    talk.wait(1)
    assert talk.times[1] == pytest.approx(88 / 9600 + 0.2)


# --- what does not end the wait --------------------------------------------------------


@pytest.mark.parametrize("noise", ["00", "FF", "FE 00", "00 FF 55", "01", "01 03"])
def test_noise_before_the_answer_does_not_end_the_wait(noise: str) -> None:
    talk = Talk(LINE)
    for number in range(40):
        batch = talk.ask(number)
        talk.come(bytes.fromhex(noise))
        talk.wait(0.03)
        talk.come(value(number))
        talk.wait(0.03)
        assert batch.outcomes == [[number]]


def test_noise_alone_is_a_frame_error_at_the_end_that_says_so() -> None:
    talk = Talk(LINE, timeout=1)
    batch = talk.ask(1)
    talk.come(bytes.fromhex("AA FE 55 AA FE 55 AA"))
    talk.wait(0.9)
    assert not batch.is_done
    talk.wait(0.1)
    assert "baud rate, parity, A and B swapped?" in str(batch.outcomes[0])


def test_another_unit_does_not_end_the_wait() -> None:
    talk = Talk(LINE, timeout=1)
    batch = talk.ask(5)
    talk.come(value(9, unit=9), value(5))
    assert batch.outcomes == [[5]]
    batch = talk.ask(5)
    talk.come(value(9, unit=9))
    talk.wait(1)
    assert kinds(batch) == [InvalidResponse]
    assert "unit 9 answered" in str(batch.outcomes[0])


def test_the_request_that_comes_back_does_not_end_the_wait() -> None:
    talk = Talk(LINE, timeout=1)
    batch = talk.ask(5)
    talk.come(talk.sent[0], value(5))
    talk.wait(0.03)  # for the echo may be the start of a longer answer
    assert batch.outcomes == [[5]]
    batch = talk.ask(5)
    talk.come(talk.sent[0])
    talk.wait(1)
    assert kinds(batch) == [ModbusTimeoutError]  # the first one has shown that requests come back
    assert "echo=True?" in str(batch.outcomes[0])


def test_an_answer_that_repeats_its_request_is_one() -> None:
    """Functions 5 and 6 are answered so (application protocol, 6.5 and 6.6)."""
    talk = Talk(LINE)
    batch = talk.ask(WRITE)
    talk.come(rtu("01 06 0001 0002"))
    assert batch.outcomes == [None]


# --- what does -------------------------------------------------------------------------


def test_a_damaged_answer_is_a_frame_error_as_soon_as_the_line_is_quiet() -> None:
    talk = Talk(LINE, timeout=1)
    batch = talk.ask(5)
    damaged = value(5)[:-1] + b"\0"
    talk.come(damaged)
    talk.wait(0.1)
    assert kinds(batch) == [FrameError]
    assert batch.outcomes[0].received == damaged
    assert talk.statistics.invalid == 1


def test_a_refusal_ends_the_wait_and_raises_no_doubt() -> None:
    talk = Talk(LINE)
    batch = talk.ask(5)
    talk.come(rtu("01 83 02"))
    assert kinds(batch) == [IllegalDataAddress]
    talk.ask(6)
    assert len(talk.sent) == 2


def test_the_answer_to_another_function_does_not_end_the_wait() -> None:
    talk = Talk(LINE)
    batch = talk.ask(5)
    talk.come(rtu("01 04 02 0005"))
    assert not batch.is_done
    talk.come(value(5))
    assert batch.outcomes == [[5]]


@pytest.mark.parametrize("body", ["01 04 02 0005", "01 84 02"])
def test_the_answer_to_another_function_alone_is_told(body: str) -> None:
    talk = Talk(LINE)
    batch = talk.ask(5)
    talk.come(rtu(body))
    talk.wait(1)
    assert kinds(batch) == [InvalidResponse]
    assert batch.outcomes[0].answers_another
    assert "function 4 was answered, not 3" in str(batch.outcomes[0])


def test_an_answer_before_the_request_can_have_left_is_an_earlier_one() -> None:
    """Eight characters take 9.2 ms at 9600 bit/s."""
    talk = Talk("rtu:///dev/nowhere?baudrate=9600&silence=0", is_timed=True)
    batch = talk.ask(5)
    talk.wait(0.008)
    talk.come(value(4))
    assert not batch.is_done
    assert talk.statistics.late_answers == 1
    talk.wait(0.010)
    talk.come(value(5))
    assert batch.outcomes == [[5]]


def test_an_echo_is_told_however_early_it_comes() -> None:
    """A two-wire transceiver hears each byte while it is sent."""
    talk = Talk("ascii:///dev/nowhere?baudrate=9600", is_timed=True)
    batch = talk.ask(5)
    talk.wait(0.005)
    talk.come(talk.sent[0])
    talk.wait(1)
    assert kinds(batch) == [InvalidResponse]
    assert "echo=True?" in str(batch.outcomes[0])


def test_a_line_that_is_faster_than_its_settings_is_believed() -> None:
    """Where nothing but an early answer came, the port is not real: adapters over networks."""
    talk = Talk("rtu:///dev/nowhere?baudrate=9600&silence=0", is_timed=True)
    first = talk.ask(5)
    talk.come(value(5))
    talk.wait(1)
    assert kinds(first) == [ModbusTimeoutError]
    talk.wait(1)
    second = talk.ask(6)
    talk.come(value(6))
    assert second.outcomes == [[6]]


def test_who_is_withdrawn_may_answer_as_late_as_who_is_not() -> None:
    talk = Talk(LINE, timeout=1)
    talk.cancel(talk.ask(5))
    talk.ask(6)
    talk.wait(1.9)
    assert len(talk.sent) == 1
    talk.wait(0.2)
    assert len(talk.sent) == 2


def test_an_answer_that_came_by_itself_is_accepted_unless_it_may_be_another_one() -> None:
    """The short way asks so; what is not accepted is looked at by the conversation."""
    talk = Talk("rtu:///dev/nowhere?baudrate=9600&silence=0", is_timed=True)
    read, equal = bytes.fromhex("03 006B 0001"), bytes.fromhex("01 0001 0003")
    talk.matching._silence.sent(8, 0.0)
    assert not talk.matching.accepts(1, read, bytes.fromhex("03 02 0007"), 0.0, 0.009)
    assert not talk.matching.accepts(1, equal, equal, 0.0, 0.1)
    assert talk.matching.accepts(1, read, bytes.fromhex("03 02 0007"), 0.0, 0.1)
    # Now it is known that requests do not come back.
    assert talk.matching.accepts(1, equal, equal, 0.0, 0.1)


@pytest.mark.parametrize(("later", "result"), [(value(1), 9), (value(8), 8)])
def test_of_two_doubtful_answers_the_later_counts_unless_it_repeats_an_earlier_one(
    later: bytes, result: int
) -> None:
    talk = Talk(LINE, timeout=1)
    first = talk.ask(1)
    talk.wait(0.2)
    talk.come(value(1))
    assert first.outcomes == [[1]]
    talk.wait(1)
    second = talk.ask(2)
    for doubtful in (value(9), later):
        talk.wait(0.02)  # sooner than the unit has ever answered
        talk.come(doubtful)
    assert kinds(second) != [[result]]
    talk.wait(1)
    assert second.outcomes == [[result]]


# --- silence after a failure -----------------------------------------------------------


def failed(talk: Talk, unit: int = 1) -> None:
    """A request that got no answer within its second."""
    assert kinds(failing := talk.ask(0, unit=unit)) != [[0]]
    talk.wait(1)
    assert kinds(failing) == [ModbusTimeoutError]


def test_the_same_unit_is_asked_again_after_a_timeout_of_silence() -> None:
    talk = Talk(LINE, timeout=1)
    failed(talk)
    batch = talk.ask(6)
    talk.wait(0.99)
    assert len(talk.sent) == 1
    talk.wait(0.01)
    talk.come(value(6))
    assert batch.outcomes == [[6]]


def test_other_units_are_asked_at_once() -> None:
    talk = Talk(LINE, timeout=1)
    failed(talk, unit=1)
    again, other = talk.ask(5, unit=1), talk.ask(6, unit=2)
    assert units(talk) == [1, 2]
    talk.come(value(6, unit=2))
    assert other.outcomes == [[6]]
    talk.wait(1)
    talk.come(value(5))
    assert again.outcomes == [[5]]


def test_a_dead_unit_costs_its_timeout_once() -> None:
    """Two living units, each asked ten times, and a dead one asked once between them."""
    talk = Talk(LINE, timeout=1)
    failed(talk, unit=9)
    for number in range(10):
        for unit in (1, 2):
            talk.ask(number, unit=unit)
            talk.come(value(number, unit=unit))
    assert talk.now == 1
    assert talk.statistics.responses == 20


def test_a_late_answer_is_dropped_and_starts_the_silence_anew() -> None:
    talk = Talk(LINE, timeout=1)
    failed(talk)
    batch = talk.ask(6)
    talk.wait_until(1.7)
    talk.come(value(0))
    talk.wait_until(2.6)
    assert len(talk.sent) == 1
    talk.wait_until(2.7)
    talk.come(value(6))
    assert batch.outcomes == [[6]]
    assert talk.statistics.late_answers == 1


def test_a_late_answer_in_another_units_turn_is_dropped_and_starts_the_silence_anew() -> None:
    talk = Talk(LINE, timeout=1)
    failed(talk, unit=1)
    other = talk.ask(6, unit=2)
    talk.wait_until(1.5)
    talk.come(value(0, unit=1))
    talk.come(value(6, unit=2))
    assert other.outcomes == [[6]]
    again = talk.ask(7, unit=1)
    talk.wait_until(2.4)
    assert units(talk) == [1, 2]
    talk.wait_until(2.5)
    talk.come(value(7, unit=1))
    assert again.outcomes == [[7]]
    assert talk.statistics.late_answers == 1


def test_a_broadcast_waits_for_the_last_of_the_units() -> None:
    talk = Talk(LINE, timeout=1)
    failed(talk)
    talk.wait(0.5)
    failed(talk, unit=2)
    owing = [talk.matching.ready_at(unit) for unit in (1, 2)]
    assert owing[0] < owing[1] == talk.matching.ready_at(0)


def test_a_broadcast_waits_for_all_units() -> None:
    talk = Talk(LINE, timeout=1)
    failed(talk, unit=1)
    everyone = talk.ask(WRITE, unit=0, is_broadcast=True)
    talk.wait(0.5)
    assert units(talk) == [1]
    talk.wait(0.5)
    assert units(talk) == [1, 0]
    talk.wait(0.1)
    assert everyone.outcomes == [None]


def test_after_a_cancelled_request_the_line_must_fall_silent_too() -> None:
    talk = Talk(LINE, timeout=1)
    talk.cancel(talk.ask(5))
    batch = talk.ask(6)
    talk.wait(0.1)
    talk.come(value(5))
    talk.wait(0.99)
    assert len(talk.sent) == 1
    talk.wait(0.01)
    talk.come(value(6))
    assert batch.outcomes == [[6]]


def test_the_silence_is_as_long_as_the_timeout_of_the_request_that_failed() -> None:
    talk = Talk(LINE, timeout=5)
    talk.ask(5, timeout=0.3)
    talk.wait(0.3)
    talk.ask(6)
    talk.wait(0.3)
    assert talk.times == pytest.approx([0, 0.6])


def trickled(talk: Talk, data: bytes, seconds: float) -> None:
    """Bytes every 100 ms."""
    for _ in range(round(seconds * 10)):
        talk.come(data)
        talk.wait(0.1)


@pytest.mark.parametrize(("data", "seconds"), [(b"\x55", 2), (b"\x55" * 100, 1)])
def test_a_line_that_does_not_fall_silent_is_waited_for_twice_as_long_and_a_flood_once(
    data: bytes, seconds: float
) -> None:
    talk = Talk(LINE, timeout=1)
    failed(talk)
    batch = talk.ask(6)
    trickled(talk, data, seconds - 0.1)
    assert not batch.is_done
    trickled(talk, data, 0.2)
    assert kinds(batch) == [FrameError]
    assert "does not fall silent" in str(batch.outcomes[0])
    assert set(batch.outcomes[0].received) == {0x55}
    assert len(batch.outcomes[0].received) <= 600
    assert len(talk.sent) == 1


def test_a_repetition_does_not_wait_for_ever_for_silence() -> None:
    talk = Talk(LINE, timeout=1, retries=1)
    batch = talk.ask(6)
    talk.wait(1)
    trickled(talk, b"\x55", 2.1)
    assert kinds(batch) == [FrameError]
    assert "does not fall silent" in str(batch.outcomes[0])
    assert talk.is_at_rest


def test_a_caller_that_left_does_not_shorten_the_patience_of_the_next() -> None:
    talk = Talk(LINE, timeout=1)
    failed(talk)
    leaving = talk.ask(6)
    trickled(talk, b"\x55", 1.5)
    talk.cancel(leaving)
    batch = talk.ask(7)
    trickled(talk, b"\x55", 0.9)
    assert not batch.is_done
    talk.wait(1)
    talk.come(value(7))
    assert batch.outcomes == [[7]]


# --- the clock -------------------------------------------------------------------------


def test_the_clock_rests_after_half_an_answer() -> None:
    """An alarm that lay in the past would have an event loop spin."""
    for end in ("timeout", "cancelled", "lost"):
        talk = Talk("rtu+tcp://192.0.2.1", timeout=1)
        batch = talk.ask(1)
        talk.wait(0.99)
        talk.come(value(1)[:4])
        if end == "timeout":
            talk.wait(0.01)
        elif end == "cancelled":
            talk.cancel(batch)
        else:
            talk.lose()
        talk.wait(5)
        assert batch.is_done
        assert is_quiet(talk), end


# --- floods ----------------------------------------------------------------------------


def test_a_flood_extends_no_timeout_and_is_not_kept() -> None:
    for url in (LINE, ASCII):
        talk = Talk(url, timeout=1)
        batch = talk.ask(1)
        with little_kept():
            for _ in range(10):
                talk.come(b":0" * 5000)
                talk.wait(0.1)
        assert batch.is_done, url
        assert len(batch.outcomes[0].received) <= 600
        assert len(str(batch.outcomes[0])) < 300


def test_the_first_600_bytes_of_a_flood_are_kept() -> None:
    """Of what comes in place of an answer, and of what comes while nobody may ask."""
    pieces = [bytes([0x80 + number]) * 250 for number in range(8)]
    kept = b"".join(pieces)[:600]
    talk = Talk(LINE, timeout=1)
    first = talk.ask(1)
    talk.come(*pieces)
    talk.wait(1)
    assert first.outcomes[0].received == kept
    second = talk.ask(2)
    for _ in range(2):
        talk.come(*pieces)
        talk.wait(0.5)
    assert len(talk.sent) == 1
    assert second.outcomes[0].received == kept


@pytest.mark.parametrize(("size", "seconds"), [(599, 2), (600, 1), (601, 1)])
def test_more_than_an_answer_is_a_flood(size: int, seconds: float) -> None:
    """Who sends less may be late with an answer, and has twice as long to fall silent."""
    talk = Talk(LINE, timeout=1)
    failed(talk)
    batch = talk.ask(6)
    asked_at = talk.now
    talk.come(b"\x55" * size)
    while not batch.is_done:
        talk.wait(0.01)
        talk.matching._silence.heard(talk.now)  # it goes on, and all of it was kept already
        talk.matching._doubts[1] = (talk.now + 1, 1)
        assert talk.now < asked_at + 3
    assert talk.now - asked_at == pytest.approx(seconds, abs=0.011)


def test_a_late_answer_in_pieces_is_one_and_each_piece_puts_off_the_next_request() -> None:
    talk = Talk(LINE, timeout=1)
    failed(talk)
    batch = talk.ask(6)
    for piece in (value(5)[:3], value(5)[3:]):
        talk.wait(0.5)
        talk.come(piece)
    assert talk.statistics.late_answers == 1
    late_at = talk.now
    talk.wait_for(2)
    assert talk.times[1] == pytest.approx(late_at + 1)
    talk.come(value(6))
    assert batch.outcomes == [[6]]


def test_a_flood_on_an_idle_line_is_noted_and_forgotten_when_somebody_asks() -> None:
    talk = Talk(LINE)
    with little_kept():
        talk.come(bytes(0x10000))
    assert not talk.conversation.is_flooded
    talk.come(b"\0")
    assert talk.conversation.is_flooded
    with little_kept():
        for _ in range(100):
            talk.come(bytes(0x1000))
    assert talk.conversation.broken is None  # a port is not opened anew for that
    batch = talk.ask(1)
    talk.wait(0.03)  # the line must have been quiet for a moment
    assert not talk.conversation.is_flooded
    talk.come(value(1))
    assert batch.outcomes == [[1]]


# --- answers that come twice ------------------------------------------------------------


def silence_before_next(talk: Talk) -> float:
    talk.ask(1)
    asked = len(talk.sent)
    talk.come(value(1))
    heard = talk.now
    talk.ask(2)
    talk.wait_for(asked + 1)
    talk.come(value(2))
    return talk.times[asked] - heard


def test_where_answers_come_twice_the_line_must_be_quiet_for_longer_for_a_minute() -> None:
    talk = Talk(LINE)
    assert silence_before_next(talk) < 0.02
    talk.come(value(2))
    talk.wait(0.02)
    assert silence_before_next(talk) >= 0.02
    talk.wait(61)
    assert silence_before_next(talk) < 0.02


def test_a_late_answer_that_is_owed_slows_nothing_down() -> None:
    talk = Talk(LINE, timeout=1)
    talk.ask(5)
    talk.wait(1.1)
    talk.come(value(5))
    talk.wait(1.1)
    assert silence_before_next(talk) < 0.02


# --- delimiters ------------------------------------------------------------------------


def test_an_accepted_delimiter_is_used_from_then_on_and_given_back_at_a_restart() -> None:
    talk = Talk(ASCII)
    talk.ask(pdu.Diagnostics(3, b"#\0"))
    assert talk.sent[-1] == b":010800032300D1\r\n"
    talk.come(b":010800032300D1\r\n")
    batch = talk.ask(1)
    assert talk.sent[-1].endswith(b"\r#")
    talk.come(ascii_frame("01 03 02 0001", b"\r#"))
    assert batch.outcomes == [[1]]
    talk.ask(pdu.Diagnostics(1, b"\0\0"))
    talk.come(ascii_frame("01 08 0001 0000", b"\r#"))
    talk.ask(1)
    assert talk.sent[-1].endswith(b"\r\n")


def test_a_refused_delimiter_is_not_used() -> None:
    talk = Talk(ASCII, delimiter=0x24)
    talk.ask(pdu.Diagnostics(3, b":\0"))
    talk.come(ascii_frame("01 88 03", b"\r$"))
    talk.ask(1)
    assert talk.sent[-1].endswith(b"\r$")


@pytest.mark.parametrize("data", [b":\0", b"\r\0", b"A\0", b"\xff\0", b"#\n"])
def test_a_delimiter_that_no_frame_can_have_is_not_used_if_a_device_echoes_it(data: bytes) -> None:
    talk = Talk(ASCII)
    batch = talk.ask(pdu.Diagnostics(3, data))
    talk.come(ascii_frame("01 08 0003" + data.hex()))
    assert batch.outcomes == [data]
    talk.lose()
    talk.open()  # with another framer
    batch = talk.ask(1, unit=2)
    assert talk.sent[-1].endswith(b"\r\n")
    talk.come(ascii_frame("02 03 02 0001"))
    assert batch.outcomes == [[1]]


def test_an_rtu_line_has_no_delimiter() -> None:
    talk = Talk(LINE)
    talk.ask(pdu.Diagnostics(3, b"#\0"))
    talk.come(rtu("01 08 0003 2300"))
    batch = talk.ask(1)
    talk.come(value(1))
    assert batch.outcomes == [[1]]


# --- the short way ---------------------------------------------------------------------


def answered(talk: Talk, *pieces: bytes) -> bool:
    talk.ask(1)
    talk.come(*pieces)
    talk.wait(0.03)
    return talk.conversation.is_plain


def test_the_short_way_needs_an_exact_answer_on_this_connection() -> None:
    talk = Talk(LINE)
    assert not talk.conversation.is_plain
    assert answered(talk, value(1))
    talk.lose()
    talk.open()
    assert not talk.conversation.is_plain


@pytest.mark.parametrize(
    "pieces",
    [
        [b"\0" + value(1)],
        [b"\0", value(1)],
        [value(9, unit=9), value(1)],
        [rtu("01 03 0001 0001"), value(1)],
        [value(1) + b"\0"],
        [value(1), b"\0"],
        [value(1) + value(1)],
    ],
)
def test_noise_closes_the_short_way_until_the_next_connection(pieces: list[bytes]) -> None:
    talk = Talk(LINE)
    assert not answered(talk, *pieces)
    if pieces != [value(1) + b"\0"]:  # the start of what may yet be a frame
        assert not answered(talk, value(1))
    talk.lose()
    talk.open()
    assert answered(talk, value(1))


def test_a_failure_closes_the_short_way_for_a_while() -> None:
    talk = Talk(LINE, timeout=1)
    assert answered(talk, value(1))
    failed(talk)
    assert not talk.conversation.is_plain
    talk.wait(1.1)
    assert answered(talk, value(1))
    assert not Talk(LINE, trace=print).conversation.is_plain


@pytest.mark.parametrize(
    "late",
    [value(1), b"\xfe\x01", value(1)[:4], value(1) + b"\x01\x03", b"\x01" + value(1)],
    ids=["an answer", "noise", "half an answer", "an answer and more", "noise and an answer"],
)
def test_what_comes_unasked_is_traced_too(late: bytes) -> None:
    told: list[Traced] = []
    talk = Talk(LINE, timeout=1, trace=told.append)
    failed(talk)
    talk.come(late)
    received = [each for each in told if each.direction == "received"]
    assert b"".join(each.adu for each in received) == late
    frames = [(each.unit, each.function) for each in received if each.unit is not None]
    assert frames == ([(1, 3)] if value(1) in late else [])
