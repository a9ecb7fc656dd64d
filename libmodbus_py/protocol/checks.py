"""
The check of numbers that callers pass; its errors name the argument and its range.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Sequence
from operator import index

from .mistakes import Path, WrongType, WrongValue

__all__ = ["are_registers", "integer", "number", "seconds", "shown"]


def shown(number: object) -> str:
    """Return a number as text for a message; Python formats at most 4300 digits."""
    if isinstance(number, int) and number.bit_length() > 128:
        return f"one of {number.bit_length()} bits"
    return str(number) if hasattr(number, "as_tuple") else reprlib.repr(number)


def integer(name: str | Path, value: object, low: int, high: int) -> int:
    """
    Return an integer of any type as an int.

    Raises:
        TypeError: no integer; True and False are none here.
        ValueError: not in low..high.
    """
    if isinstance(value, bool):
        raise WrongType(name, f"must be an integer in {low}..{high}, not {value!r}")
    try:
        number = index(value)  # type: ignore[arg-type]
    except TypeError:
        given = type(value).__name__
        raise WrongType(name, f"must be an integer in {low}..{high}, not {given}") from None
    if not low <= number <= high:
        raise WrongValue(name, f"must be in {low}..{high}, not {shown(number)}")
    return number


def number(name: str | Path, value: object, low: float, high: float) -> int | float:
    """
    Return a number as it is; `high` is infinite if there is no upper bound.

    Raises:
        TypeError: no int or float; True and False are none here.
        ValueError: not in low..high, or not a number at all (nan).
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise WrongType(name, f"must be a number, not {type(value).__name__}")
    if not low <= value <= high:
        span = f"{low} or more" if high == math.inf else f"in {low}..{high}"
        raise WrongValue(name, f"must be {span}, not {shown(value)}")
    return value


def are_registers(values: Sequence[object]) -> bool:
    """Return True if all are plain ints in 0..65535; fast, because bulk reads do little else."""
    return set(map(type, values)) == {int} and min(values) >= 0 and max(values) <= 0xFFFF  # type: ignore[type-var, operator]


def seconds(name: str | Path, value: object, low: float = 0.001, high: float = 86_400.0) -> float:
    """
    Return a number of seconds as a float.

    Raises:
        TypeError: no number.
        ValueError: not in low..high.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise WrongType(name, f"must be a number of seconds, not {type(value).__name__}")
    if not low <= value <= high:
        given = f"{value:g}" if isinstance(value, float) else shown(value)
        raise WrongValue(name, f"must be in {low:g}..{high:g} seconds, not {given}")
    return float(value)
