"""
The earlier answers with which those on a line are compared.
"""

from __future__ import annotations

from libmodbus_py import pdu
from libmodbus_py.client.answers import REMEMBERED, Answers
from tests.support.talk import little_kept

REQUEST = pdu.ReadHoldingRegisters(0, 1).encode()


def read(address: int) -> bytes:
    return pdu.ReadHoldingRegisters(address, 1).encode()


def holding(value: int) -> bytes:
    return pdu.ReadHoldingRegisters(0, 1).encode_response([value])


def test_an_answer_is_one_to_another_request_until_that_gets_another_one_and_eight_more() -> None:
    answers = Answers()
    answers.add(1, read(0), holding(5))
    assert answers.is_of_another(1, read(1), holding(5))
    assert not answers.is_of_another(1, read(0), holding(5))
    assert not answers.is_of_another(2, read(1), holding(5))
    for value in range(8):
        assert answers.is_of_another(1, read(1), holding(5))
        answers.add(1, read(0), holding(100 + value))
    assert not answers.is_of_another(1, read(1), holding(5))


def test_the_last_answer_to_the_request_itself_is_its_own() -> None:
    answers = Answers()
    for address in (0, 1):
        answers.add(1, read(address), holding(5))
    assert not answers.is_of_another(1, read(0), holding(5))


def test_writes_of_other_values_to_the_same_cells_are_the_same_request() -> None:
    """Their answer contains no values (functions 15, 16), or those of the read (23)."""
    answers = Answers()
    one, other = (pdu.WriteRegisters(7, [value]) for value in (1, 2))
    answers.add(1, one.encode(), one.encode_response(None))
    assert not answers.is_of_another(1, other.encode(), other.encode_response(None))


def test_values_that_change_for_ever_take_no_more_memory() -> None:
    answers = Answers()
    for value in range(2 * REMEMBERED):
        answers.add(1, REQUEST, holding(value))
    with little_kept():
        for value in range(0x10000):
            answers.add(1, REQUEST, holding(value))


def test_requests_that_change_for_ever_take_no_more_memory() -> None:
    answers = Answers()
    for address in range(0x10000):
        answers.add(1, read(address), holding(address))
        answers.note_time(1 + address % 200, bytes([3, 2]) * (1 + address % 120), 0.1)
    assert answers.slowest == 0.1
    with little_kept():
        answers.add(1, REQUEST, holding(0))
