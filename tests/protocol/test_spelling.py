"""
Numbers that people type.
"""

from __future__ import annotations

import pytest

from libmodbus_py import InvalidResponse
from libmodbus_py.pdu import ReadHoldingRegisters
from libmodbus_py.protocol.spelling import number_of


@pytest.mark.parametrize(("text", "number"), [("31", 31), ("0x1F", 31), ("0b11", 3), ("-1", -1)])
def test_integers_are_read_as_python_writes_them(text: str, number: int) -> None:
    assert number_of("unit", text) == number


@pytest.mark.parametrize("text", ["", "x", "1.5", "010"])
def test_what_is_no_integer_is_refused_by_name(text: str) -> None:
    with pytest.raises(ValueError, match="unit must be a number, not"):
        number_of("unit", text)


@pytest.mark.parametrize(
    ("response", "answers_another"),
    [(b"\x03", False), (b"\x83\x02\x00", False), (b"\x84\x02", True), (b"\x04\x02\x00\x01", True)],
)
def test_a_response_of_another_function_belongs_to_another_request(
    response: bytes, answers_another: bool
) -> None:
    with pytest.raises(InvalidResponse) as invalid:
        ReadHoldingRegisters(0, 1).decode_response(response)
    assert invalid.value.answers_another is answers_another
