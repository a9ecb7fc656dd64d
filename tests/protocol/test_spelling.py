"""
Values as people read and type them.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

import pytest

from libmodbus_py import InvalidResponse
from libmodbus_py.pdu import ReadHoldingRegisters
from libmodbus_py.protocol.plain import (
    bit_of,
    decimal_of,
    number_of,
    text_of,
    time_of,
    units_of,
    value_of,
)
from libmodbus_py.protocol.values import value_type
from tests.support.cases import each_case


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


@each_case(
    ("kind", "value", "text"),
    [
        ("float16", 3.140625, "3.14"),
        ("float16", 2.0**-24, "5.96e-08"),
        ("float16", 65504.0, "65500.0"),
        ("float32", 3.140000104904175, "3.14"),
        ("float32", 2.0**-149, "1.4013e-45"),
        ("float32", 1048576.125, "1048576.1"),
        ("float64", 0.1 + 0.2, "0.30000000000000004"),
        ("float64", 5e-324, "5e-324"),
        ("float64", math.inf, "inf"),
        ("float64", -math.nan, "nan"),
        ("uint16", 7, "7"),
        ("bits16", [True, False] * 8, "1010101010101010"),
        ("string:4", "it's", '"it\'s"'),
        ("unix32", datetime(2026, 7, 1, 12, tzinfo=UTC), "2026-07-01T12:00:00+00:00"),
    ],
)
def test_a_value_is_shown_as_its_shortest_text(kind: str, value: Any, text: str) -> None:
    assert text_of(value, value_type(kind)) == text


@each_case(
    ("kind", "text", "value"),
    [
        ("float32", "21.5", 21.5),
        ("uint16", "0x1F", 31),
        ("bits16", "10", [1, 0]),
        ("string:4", " a'", " a'"),
        ("unix32", "2026-07-01T12:00:00Z", datetime(2026, 7, 1, 12, tzinfo=UTC)),
    ],
)
def test_a_value_is_typed_as_it_is_shown(kind: str, text: str, value: Any) -> None:
    assert value_of(text, value_type(kind)) == value


def test_bits_have_words() -> None:
    for text, bit in (("0", False), ("off", False), ("FALSE", False)):
        assert bit_of(text) is bit
    for text in ("1", "on", "True"):
        assert bit_of(text) is True
    with pytest.raises(ValueError, match=r"^value must be one of 0, 1, off, on, false, true, not"):
        bit_of("2")


def test_a_decimal_number_is_finite_unless_it_is_called_infinite() -> None:
    assert decimal_of("-INF") == -math.inf
    assert decimal_of("1e308") == 1e308
    with pytest.raises(ValueError, match=r"^value is too large: '1e400'"):
        decimal_of("1e400")
    with pytest.raises(ValueError, match=r"^value must be a number, not 'x'"):
        decimal_of("x")


@each_case("text", ["", "12", "1 0", "x", "-1", "0x1"])
def test_bits_are_digits_0_and_1(text: str) -> None:
    with pytest.raises(ValueError, match=r"^value must be digits 0 and 1, lowest bit first, not"):
        value_of(text, value_type("bits16"))


@each_case("text", ["2026-07-01T12:00:00", "2026-07-01", "noon", ""])
def test_a_time_has_a_time_zone(text: str) -> None:
    with pytest.raises(ValueError, match=r"^value must be a date and time with a time zone"):
        time_of(text)


@each_case(
    ("text", "units"),
    [("1", [1]), (" 0 , 255", [0, 255]), ("3-5,4", [3, 4, 5, 4]), ("7 - 7", [7])],
)
def test_units_are_numbers_and_ranges(text: str, units: list[int]) -> None:
    assert units_of(text) == units


@each_case("text", ["", "1,", "256", "5-3", "1-256", "-1", "1-2-3", "x", "0x1"])
def test_what_is_no_list_of_units_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"must (be|go up,) (a unit|within 0\.\.255)"):
        units_of(text)
