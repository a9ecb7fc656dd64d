"""
What is made of answers on lines without ids: damaged, early, doubled, foreign, and equal to their
requests.
"""

from __future__ import annotations

from libmodbus_py import FrameError, InvalidResponse, ModbusTimeoutError, pdu
from tests.support.cases import each_case
from tests.support.talk import ASCII, LINE, Talk, ascii_frame, kinds, rtu, value


def test_a_damaged_answer_ends_the_wait_at_once() -> None:
    """Of ASCII, whose frames have an end: nothing more of it will come."""
    talk = Talk(ASCII, timeout=5)
    for frame in (b":0103020005F6\r\n", b":01030200zz\r\n", b":0183\r\n"):
        batch = talk.ask(5)
        talk.come(frame)
        assert kinds(batch) == [FrameError], frame
        assert batch.outcomes[0].received == frame
        talk.wait(11)


def test_noise_is_no_damaged_answer() -> None:
    talk = Talk(ASCII, timeout=5)
    batch = talk.ask(5)
    talk.come(b":7703020005F6\r\n")
    assert not batch.is_done
    talk.come(ascii_frame("01 03 02 0005"))
    assert batch.outcomes == [[5]]


def test_a_request_that_comes_back_and_cannot_be_its_answer_is_none() -> None:
    talk = Talk(ASCII, timeout=1)
    batch = talk.ask(pdu.WriteRegisters(1, (7,)))
    talk.come(talk.sent[-1])
    assert not batch.is_done
    talk.come(ascii_frame("01 10 0001 0001"))
    assert batch.outcomes == [None]


def test_a_mistake_in_the_class_of_a_request_is_met_once() -> None:
    class Mistaken(pdu.WriteRegister):
        __slots__ = ()

        def _decode_response(self, pdu: bytes) -> None:
            raise ZeroDivisionError

    talk = Talk(LINE, timeout=1)
    batch, other = talk.ask(Mistaken(1, 2)), talk.ask(5)
    talk.come(talk.sent[-1])
    assert kinds(batch) == [ZeroDivisionError]
    talk.come(value(5))
    assert other.outcomes == [[5]]
    assert talk.is_at_rest


def test_only_the_unit_that_owes_an_answer_is_left_alone() -> None:
    talk = Talk(LINE, timeout=0.1)
    talk.ask(1, unit=7)
    talk.wait(0.1)
    assert talk.matching.ready_at(7) == 0.2
    assert talk.matching.ready_at(8) == 0.0
    assert talk.matching.ready_at(0) == 0.2  # a broadcast is for all
    batch = talk.ask(2, unit=8)
    assert len(talk.sent) == 2
    talk.come(value(2, unit=8))
    assert batch.outcomes == [[2]]


@each_case(("come", "late"), [(b"", 0), (value(1), 1), (value(1) + value(1), 2)])
def test_answers_beside_the_first_are_counted(come: bytes, late: int) -> None:
    talk = Talk(LINE, timeout=1)
    batch = talk.ask(1)
    talk.come(value(1) + come)
    assert batch.outcomes == [[1]]
    assert talk.statistics.late_answers == late


@each_case(
    ("frame", "reason"),
    [
        (rtu("01 04 02 0005"), "function 4 was answered, not 3"),
        (rtu("01 84 02"), "function 4 was answered, not 3"),
        (value(5, unit=9), "unit 9 answered"),
    ],
)
def test_the_answer_to_another_request_is_told_at_the_end(frame: bytes, reason: str) -> None:
    talk = Talk(LINE, timeout=1)
    batch = talk.ask(5)
    talk.come(frame)
    assert not batch.is_done
    talk.wait(1)
    (error,) = batch.outcomes
    assert isinstance(error, InvalidResponse)
    assert reason in str(error)
    assert error.answers_another
    assert talk.statistics.invalid == 1


def test_a_port_that_is_faster_than_its_settings_costs_one_timeout() -> None:
    """8 bytes of 11 bits take 9 ms at 9600 bit/s: what comes sooner is an earlier answer."""
    talk = Talk("rtu:///dev/nowhere?baudrate=9600", is_timed=True, timeout=1)
    batch = talk.ask(1)
    talk.wait(0.005)
    talk.come(value(1))
    assert not batch.is_done
    assert talk.statistics.late_answers == 1
    talk.wait(1)
    assert kinds(batch) == [ModbusTimeoutError]
    batch = talk.ask(2)
    talk.wait_for(2)
    talk.wait(0.005)
    talk.come(value(2))
    talk.wait(0.2)
    assert batch.outcomes == [[2]]


def test_an_answer_in_time_shows_that_an_early_one_was_a_copy() -> None:
    talk = Talk("rtu:///dev/nowhere?baudrate=9600", is_timed=True, timeout=1)
    for number in (1, 2):
        batch = talk.ask(number)
        talk.wait_for(number)
        talk.wait(0.005)
        talk.come(value(77))
        talk.wait(0.02)
        assert not batch.is_done
        talk.come(value(number))
        talk.wait(0.2)
        assert batch.outcomes == [[number]]


def silent_after_a_copy() -> Talk:
    """Return a talk whose unit sent a copy beside its answer, and then nothing to a request."""
    talk = Talk("rtu:///dev/nowhere?baudrate=9600", is_timed=True, timeout=1)
    batch = talk.ask(1)
    talk.wait(0.005)
    talk.come(value(77))
    talk.wait(0.02)
    talk.come(value(1))
    assert batch.outcomes == [[1]]
    talk.ask(2)
    talk.wait(2)
    return talk


def test_copies_beside_answers_in_time_leave_the_speed_of_a_port_as_it_is_set() -> None:
    talk = silent_after_a_copy()
    batch = talk.ask(3)
    talk.wait_for(3)  # and up to 9 ms more
    talk.come(value(77))
    talk.wait(0.02)
    assert not batch.is_done
    talk.come(value(3))
    talk.wait(0.2)
    assert batch.outcomes == [[3]]


def test_a_copy_beside_an_answer_says_nothing_of_a_later_silence() -> None:
    """The unit was silent; so what comes too early afterwards is still no answer."""
    talk = silent_after_a_copy()
    batch = talk.ask(3)
    talk.wait_for(3)  # and up to 9 ms more
    talk.come(value(78))
    talk.wait(2)
    assert kinds(batch) == [ModbusTimeoutError]


def test_an_answer_is_a_sign_of_life_on_lines_over_networks() -> None:
    talk = Talk("rtu+tcp://192.0.2.1", timeout=1)
    for number in range(1, 8):
        batch = talk.ask(number)
        talk.wait_for(number)
        if number % 3 == 0:
            talk.come(value(number))
            assert batch.outcomes == [[number]]
        else:
            talk.wait(1)
            assert kinds(batch) == [ModbusTimeoutError]
        assert talk.conversation.broken is None
    assert talk.statistics.connects == 1
