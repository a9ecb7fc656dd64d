"""Numbers that callers pass are checked, and errors name the argument and its range."""

import math
import pickle
from decimal import Decimal
from typing import Any

import pytest

from libmodbus_py.protocol.checks import are_registers, duration_of, integer, number, seconds, shown
from libmodbus_py.protocol.mistakes import WrongType, WrongValue
from tests.support.cases import each_case
from tests.support.golden import Refused


class Five:
    """An integer of another type."""

    def __index__(self) -> int:
        return 5


def test_an_integer_of_any_type_becomes_an_int() -> None:
    assert [integer("count", value, 1, 9) for value in (1, 9)] == [1, 9]
    assert type(integer("count", Five(), 1, 9)) is int


@each_case("value", [True, False, 1.0, "1", None])
def test_what_is_no_integer_has_the_wrong_type(value: Any) -> None:
    with pytest.raises(TypeError, match=r"^count must be an integer in 0\.\.9, not "):
        integer("count", value, 0, 9)


@each_case("value", [0, 10, -1, 1 << 20_000])
def test_an_integer_has_to_be_in_its_range(value: int) -> None:
    with pytest.raises(ValueError, match=r"^count must be in 1\.\.9, not "):
        integer("count", value, 1, 9)


def test_a_number_stays_what_it_is() -> None:
    for value in (0, 9, 0.0, 9.0):
        assert number("scale", value, 0, 9) is value
    assert number("scale", math.inf, 0, math.inf) == math.inf


@each_case("value", [True, "1", None, 1j, Decimal(1)])
def test_what_is_no_number_has_the_wrong_type(value: Any) -> None:
    with pytest.raises(TypeError, match=r"^scale must be a number, not "):
        number("scale", value, 0, 9)
    with pytest.raises(TypeError, match=r"^pause must be a number of seconds, not "):
        seconds("pause", value)


def test_a_number_has_to_be_in_its_range(refused: Refused) -> None:
    refused("wrong_numbers.txt", lambda given: number("scale", given[0], 0, given[1]))


def test_seconds_become_a_float() -> None:
    for value in (1, 0.001, 86_400):
        assert seconds("pause", value) == value
        assert type(seconds("pause", value)) is float
    assert seconds("pause", 0, low=0) == 0
    assert seconds("pause", 90_000, high=90_000) == 90_000


def test_seconds_have_to_be_in_their_range(refused: Refused) -> None:
    refused("wrong_seconds.txt", lambda value: seconds("pause", value))


def test_registers_are_plain_ints_of_16_bits() -> None:
    assert are_registers([0, 65_535])
    for values in ([0, 65_536], [-1, 0], [0, True], [0, 1.0], [Five()]):
        assert not are_registers(values)


@each_case(
    ("value", "text"),
    [
        (2**128 - 1, str(2**128 - 1)),
        (2**128, "one of 129 bits"),
        (Decimal("1.50"), "1.50"),
        ("x" * 99, f"'{'x' * 12}...{'x' * 13}'"),
    ],
)
def test_a_value_is_short_in_messages(value: object, text: str) -> None:
    assert shown(value) == text


@each_case(
    ("text", "seconds"),
    [
        ("0.5", 0.5),
        ("-3", -3.0),
        ("1e3", 1000.0),
        ("500ms", 0.5),
        ("1ms", 0.001),
        ("1.5s", 1.5),
        ("10s", 10.0),
        ("2m", 120.0),
        ("2min", 120.0),
        ("1h", 3600.0),
        ("1d", 86_400.0),
        ("1h30m", 5400.0),
        (" 1 h 30 min 1 s ", 5401.0),
        ("2d1h1m1s1ms", 176_461.001),
        ("999999999s", 999_999_999.0),
        ("0.123456789s", 0.123456789),
    ],
)
def test_a_duration_has_units_or_none(text: str, seconds: float) -> None:
    assert duration_of(text) == seconds
    assert type(duration_of(text)) is float


@each_case("text", ["", "s", "1x", "1h-5m", "1,5s", "1H", "\u0661s", "1h30", "1000000000s"])
def test_any_other_text_is_no_duration(text: str) -> None:
    with pytest.raises(ValueError, match="could not convert"):
        duration_of(text)


@each_case(
    "mistake",
    [
        WrongValue("unit", "must be in 0..255, not 300"),
        WrongValue(path=("route", 3, "url"), reason="must be a URL"),
        WrongType.about(("route", 3), "it is given twice"),
    ],
)
def test_a_mistake_survives_pickling(mistake: WrongValue | WrongType) -> None:
    copy = pickle.loads(pickle.dumps(mistake))
    assert type(copy) is type(mistake)
    assert (str(copy), copy.path, copy.args) == (str(mistake), mistake.path, mistake.args)
