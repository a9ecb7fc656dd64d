"""
The names of the numbers of a point: of single numbers, of ranges, and of all others.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from ..protocol.mistakes import WrongValue

__all__ = ["ELSE", "NumberSpan", "States"]

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
        keys = sorted(key for key, each in self.items() if each == name)
        spans = [span.key for span, each in self._spans if each == name]
        if len(keys) == 1 and not spans:
            return keys[0]
        if keys or spans:
            several = ", ".join(map(str, [*keys, *spans]))
            raise WrongValue("value", f"must be a number: {name!r} is the name of {several}")
        allowed = ", ".join(dict.fromkeys(self.values()))
        raise WrongValue("value", f"must be one of {allowed}, or a number, not {name!r}")
