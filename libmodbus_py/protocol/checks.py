"""
The checks of what callers pass: numbers, durations that people type (0.5, 500ms, 1h30m), functions.

Errors name the argument and its range. The package calls functions of users at once, and awaits
nothing. The body of ``async def`` would never run, so that a hook refused nothing, and a guard that
returned a coroutine, which is true, allowed all.
"""

from __future__ import annotations

import math
import re
import reprlib
from collections.abc import Collection, Sequence
from functools import partial
from operator import index
from types import AsyncGeneratorType, CoroutineType, GeneratorType
from typing import Any, TypeVar

from .mistakes import Path, WrongType, WrongValue

Given = TypeVar("Given")
Result = TypeVar("Result")


def shown(number: object) -> str:
    """Return a number as text for a message; Python formats at most 4300 digits."""
    if isinstance(number, int) and number.bit_length() > 128:
        return f"one of {number.bit_length()} bits"
    return str(number) if hasattr(number, "as_tuple") else reprlib.repr(number)


def integer(name: str | Path, value: object, low: int, high: int) -> int:
    """Return an integer of any type in low..high as an int; True and False are refused."""
    if isinstance(value, bool):
        raise WrongType(name, f"must be an integer in {low}..{high}, not {value!r}")
    try:
        number = index(value)  # type: ignore[arg-type]
    except TypeError:
        kind = type(value).__name__
        raise WrongType(name, f"must be an integer in {low}..{high}, not {kind}") from None
    if not low <= number <= high:
        raise WrongValue(name, f"must be in {low}..{high}, not {shown(number)}")
    return number


def number(name: str | Path, value: object, low: float, high: float) -> int | float:
    """Return an int or float in low..high unchanged; nan, True and False are refused."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise WrongType(name, f"must be a number, not {type(value).__name__}")
    if not low <= value <= high:
        span = f"{low} or more" if high == math.inf else f"in {low}..{high}"
        raise WrongValue(name, f"must be {span}, not {shown(value)}")
    return value


def instance(name: str | Path, value: Any, kind: Any, form: str) -> Any:
    """Return an object of a class, or of one of several; raise a TypeError for any other."""
    if not isinstance(value, kind):
        raise WrongType(name, f"must be {form}, not {type(value).__name__}")
    return value


def string(name: str | Path, value: object) -> str:
    """Return a text; raise a TypeError for anything else."""
    text: str = instance(name, value, str, "a string")
    return text


def choice(name: str | Path, value: Any, choices: Collection[str]) -> Any:
    """Return one of some words; raise a ValueError for anything else."""
    if value not in choices:
        raise WrongValue(name, f"must be one of {', '.join(choices)}, not {reprlib.repr(value)}")
    return value


def are_registers(values: Sequence[object]) -> bool:
    """Return True if all are plain ints in 0..65535; fast, because bulk reads do little else."""
    return set(map(type, values)) == {int} and min(values) >= 0 and max(values) <= 0xFFFF  # type: ignore[type-var, operator]


def seconds(name: str | Path, value: object, low: float = 0.001, high: float = 86_400) -> float:
    """Return a number of seconds in low..high as a float."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise WrongType(name, f"must be a number of seconds, not {type(value).__name__}")
    if not low <= value <= high:
        text = f"{value:g}" if isinstance(value, float) else shown(value)
        raise WrongValue(name, f"must be in {low:g}..{high:g} seconds, not {text}")
    return float(value)


DURATION = "a number of seconds, or such as 500ms, 10s, 2m, 1h30m or 1d"
"""The texts that are durations, for errors."""

_SECONDS = {"ms": 0.001, "s": 1, "m": 60, "min": 60, "h": 3600, "d": 86_400}

_PART = r"([0-9]{1,9}(?:\.[0-9]{1,9})?)\s*(ms|s|min|m|h|d)\s*"


def duration_of(text: str) -> float:
    """Return the seconds of a duration; raise a ValueError for a text that is none."""
    if not re.fullmatch(f"(?:{_PART})+", text.strip(), re.ASCII):
        return float(text)
    parts = re.findall(_PART, text, re.ASCII)
    return float(sum(float(number) * _SECONDS[unit] for number, unit in parts))


# --- functions -----------------------------------------------------------------------------

UNSTARTED = (CoroutineType, GeneratorType, AsyncGeneratorType)
"""The types of results that stand for a body of which nothing has run."""

# Flags of code (inspect): generators, coroutines, both in one, and asynchronous generators.
NOT_AT_ONCE = 0x20 | 0x80 | 0x100 | 0x200


def checked_callback(name: str | Path, callback: Given) -> Given:
    """Return a user's function; raise a TypeError unless a call runs its body at once."""
    if not callable(callback):
        raise WrongType(name, f"must be a function, not {type(callback).__name__}")
    function: Any = callback
    while isinstance(function, partial):
        function = function.func
    code = getattr(function, "__code__", None)
    if code is None:  # an object with __call__; a method has the code of its function
        code = getattr(type(function).__call__, "__code__", None)
    flags = getattr(code, "co_flags", 0)
    if isinstance(flags, int) and flags & NOT_AT_ONCE:
        raise WrongType(name, "must be a plain function, because nothing awaits async def")
    return callback


def finished(name: str, result: Result) -> Result:
    """Return the result of a function of a user; raise a TypeError if it has yet to run."""
    if isinstance(result, UNSTARTED):
        if not isinstance(result, AsyncGeneratorType):
            result.close()
        raise TypeError(f"{name} returned a {type(result).__name__}, which nothing awaits")
    return result


def log_failure(logger: str, text: str, *args: object) -> None:
    """Log the exception that is being handled; one that a log handler raises goes to stderr."""
    _log(logger, "exception", text, args)


def log_warning(logger: str, text: str, *args: object) -> None:
    """Log a warning, as `log_failure` does."""
    _log(logger, "warning", text, args)


def _log(logger: str, method: str, text: str, args: tuple[object, ...]) -> None:
    try:
        from .logs import HarmlessLogger  # imported here, because most programs log nothing
    except OSError:  # logging cannot be imported, because no descriptor is left
        return
    getattr(HarmlessLogger(logger), method)(text, *args, stacklevel=3)
