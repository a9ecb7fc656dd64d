"""Numbers that callers pass are checked, and errors name the argument and its range."""

import pickle
from decimal import Decimal

import pytest

from libmodbus_py.protocol.checks import duration_of, number, seconds, shown
from libmodbus_py.protocol.mistakes import WrongType, WrongValue
from tests.support.cases import each_case
from tests.support.golden import Refused


def test_a_number_has_to_be_in_its_range(refused: Refused) -> None:
    refused("wrong_numbers.txt", lambda case: number("scale", case[0], 0, case[1]))


def test_seconds_have_to_be_in_their_range(refused: Refused) -> None:
    refused("wrong_seconds.txt", lambda value: seconds("pause", value))


@each_case(
    ("value", "text"),
    [
        (2**128 - 1, str(2**128 - 1)),
        (2**128, "one of 129 bits"),
        (Decimal("1.50"), "1.50"),
        ("x" * 99, f"'{'x' * 12}...{'x' * 13}'"),
    ],
)
def test_a_value_is_shortened_in_messages(value: object, text: str) -> None:
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
def test_a_duration_may_have_units(text: str, seconds: float) -> None:
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
def test_a_mistake_can_be_pickled(mistake: WrongValue | WrongType) -> None:
    copy = pickle.loads(pickle.dumps(mistake))
    assert type(copy) is type(mistake)
    assert (str(copy), copy.path, copy.args) == (str(mistake), mistake.path, mistake.args)
