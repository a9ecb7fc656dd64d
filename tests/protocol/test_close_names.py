"""
Errors that name the option which was meant.
"""

import pytest

from libmodbus_py.protocol.mistakes import (
    close_option,
    close_to,
    named_arguments,
    unknown_option,
)
from tests.support.cases import each_case

KNOWN = ["unit", "timeout", "retries"]


@each_case(
    ("name", "end"),
    [
        ("slave", "; did you mean unit?"),
        ("SLAVE_ID", "; did you mean unit?"),
        ("retry_count", "; did you mean retries?"),
        ("timeuot", "; did you mean timeout?"),
        (
            "url baud",
            "; baudrate is part of the URL of a serial port: rtu:///dev/ttyUSB0?baudrate=...",
        ),
        (
            "url parity",
            "; parity is part of the URL of a serial port: rtu:///dev/ttyUSB0?parity=...",
        ),
        ("parity", ""),
        ("endian", ""),
        ("xyz", ""),
    ],
)
def test_an_option_is_named_by_what_other_packages_call_it(name: str, end: str) -> None:
    *others, name = name.split()
    known = [*KNOWN, *others]
    assert close_option(name, known) == end
    error = unknown_option(name, known)
    assert str(error) == f"'{name}' must be one of {', '.join(known)}{end}"


def test_up_to_three_names_are_close() -> None:
    names = [f"point_{each}" for each in "abcd"]
    found = close_to("point_x", names, "points.")
    assert found.startswith("; did you mean points.point_")
    assert found.count("points.") == 3
    assert close_to(7, names) == close_to("far", names) == ""


@named_arguments
class Valve:
    def __init__(self, unit: int, *, timeout: float = 1.0) -> None:
        self.unit = unit - 0
        self.timeout = timeout


@named_arguments
class Tank:
    def __init__(self, unit: int, **options: object) -> None:
        self.options = options


def test_an_argument_that_a_class_does_not_take_is_refused_with_a_close_name() -> None:
    assert (Valve(3).unit, Valve(3, timeout=2).timeout) == (3, 2)
    with pytest.raises(TypeError, match="'slave' must be one of unit, timeout; did you mean unit"):
        Valve(slave=3)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match=r"^'time_out' must be .* did you mean timeout"):
        Valve(3, time_out=2)  # type: ignore[call-arg]


def test_other_mistakes_are_told_as_python_tells_them() -> None:
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'unit'"):
        Valve()  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="unsupported operand"):
        Valve("3")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="there is no 'slave'; did you mean unit"):
        Tank(slave=3)  # type: ignore[call-arg]
    assert Tank(3, slave=4).options == {"slave": 4}
