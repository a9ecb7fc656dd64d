"""
The check of numbers that callers pass, and of durations that people type: 0.5, 500ms, 1h30m.

Errors name the argument and its range.
"""

from __future__ import annotations

import math
import re
import reprlib
from collections.abc import Sequence
from operator import index

from .mistakes import Path, WrongType, WrongValue

__all__ = ["DURATION", "are_registers", "duration_of", "integer", "number", "seconds", "shown"]


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


DURATION = "a number of seconds, or such as 500ms, 10s, 2m, 1h30m or 1d"
"""The texts that are durations, for errors."""

_SECONDS = {"ms": 0.001, "s": 1, "m": 60, "min": 60, "h": 3600, "d": 86_400}

_PART = r"([0-9]{1,9}(?:\.[0-9]{1,9})?)\s*(ms|s|min|m|h|d)\s*"


def duration_of(text: str) -> float:
    """
    Return the seconds of a duration.

    Raises:
        ValueError: the text is none.
    """
    if not re.fullmatch(f"(?:{_PART})+", text.strip(), re.ASCII):
        return float(text)
    parts = re.findall(_PART, text, re.ASCII)
    return float(sum(float(number) * _SECONDS[unit] for number, unit in parts))
