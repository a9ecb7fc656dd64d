"""
The names of the numbers of a point: of single numbers, of ranges, and of all others.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any, NamedTuple

from ..protocol.checks import integer, number
from ..protocol.mistakes import Path, WrongValue
from ..protocol.plain import shortest
from ..protocol.values import ValueType

ELSE = "else"
"""The key of the name of all numbers that have no other."""


class NumberSpan(NamedTuple):
    """The numbers from `low` to `high`, both included; `key` is how a map writes it."""

    low: float
    high: float
    key: str


class States(dict[Any, Any]):
    """
    The name of each number, which is the number itself if it has none.

    `names` are by number, by `NumberSpan` and by `ELSE`. A number of its own comes before a range,
    and a range before `ELSE`.
    """

    def __init__(self, names: Mapping[Any, str]) -> None:
        self._spans = [(key, name) for key, name in names.items() if isinstance(key, NumberSpan)]
        self._default = names.get(ELSE)
        self.is_simple: bool = not (self._spans or self._default)  # `get` does, which is faster
        spans = {key for key, _ in self._spans}
        super().__init__({key: names[key] for key in names if key not in spans and key != ELSE})

    def __missing__(self, number: Any) -> Any:
        for span, name in self._spans:
            if span.low <= number <= span.high:
                return name
        return number if self._default is None else self._default

    def number_of(self, name: str) -> Any:
        """Return the number of a name; raise WrongValue if there is none, or several."""
        keys = sorted(key for key, state in self.items() if state == name)
        spans = [span.key for span, state in self._spans if state == name]
        if len(keys) == 1 and not spans:
            return keys[0]
        if keys or spans:
            several = ", ".join(map(str, [*keys, *spans]))
            raise WrongValue("value", f"must be a number: {name!r} is the name of {several}")
        names = ", ".join(dict.fromkeys(self.values()))
        raise WrongValue("value", f"must be one of {names}, or a number, not {name!r}")


# --- keys of maps -------------------------------------------------------------------------------


def state_key(
    path: Path, key: object, limits: tuple[float, float], floats: ValueType | None
) -> int | float | str | NumberSpan:
    """
    Return the number, range or `ELSE` that a key of a map says; raise TypeError or ValueError.

    `floats` is the type of the numbers if they are floats.
    """
    if key == ELSE:
        return ELSE
    if not isinstance(key, str) or ".." not in key:
        return _number_of(path, key, limits, floats)
    first, _, last = (word.strip() for word in key.partition(".."))
    low = _number_of(path, first, limits, floats) if first else limits[0]
    high = _number_of(path, last, limits, floats) if last else limits[1]
    if low > high:
        raise WrongValue(path, "must have the lower number first")
    return NumberSpan(low, high, f"{first}..{last}")


def check_spans(keys: Iterable[object]) -> None:
    """Raise WrongValue for ranges that have numbers in common."""
    spans = sorted(key for key in keys if isinstance(key, NumberSpan))
    for first, second in pairwise(spans):
        if second.low <= first.high:
            raise WrongValue(("states", second.key), f"overlaps {first.key}")


def _number_of(
    path: Path, key: object, limits: tuple[float, float], floats: ValueType | None
) -> int | float:
    if isinstance(key, str):
        key = _number_in(path, key, is_float=floats is not None)
    if floats is None:
        return integer(path, key, int(limits[0]), int(limits[1]))
    # As registers hold it: a float32 has fewer digits than a key may have.
    return shortest(floats.unpack(floats.pack(path, number(path, key, *limits))), floats.name)


def _number_in(path: Path, text: str, *, is_float: bool) -> int | float:
    try:
        return int(text[:40], 0)
    except ValueError:
        if is_float:
            with contextlib.suppress(ValueError):
                return float(text[:40])
    raise WrongValue.about(path, "the key must be a number, a range such as 1..5, or else")
