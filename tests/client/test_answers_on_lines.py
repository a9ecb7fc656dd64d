"""
What is made of answers on lines without ids: damaged, doubled, foreign, equal to their requests.
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
    assert talk.matching.ready_at(7) == talk.matching.ready_at(7, 3) == 0.2
    assert talk.matching.ready_at(7, 4) == talk.matching.ready_at(8) == 0.0
    assert talk.matching.ready_at(0) == 0.0  # a broadcast has no answer
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
    assert talk.statistics.late_answers == 1


def test_an_answer_is_a_sign_of_life_on_lines_over_networks() -> None:
    talk = Talk("rtu+tcp://192.0.2.1", timeout=1)
    for number in range(8):
        batch = talk.ask(number)
        talk.wait_for(number + 1)
        if number % 3 == 0:
            talk.come(value(number))
            talk.wait(0)
            assert batch.outcomes == [[number]]
        else:
            talk.wait(1)
            assert kinds(batch) == [ModbusTimeoutError]
        assert talk.connection.broken is None
    assert talk.statistics.connects == 1
