"""
The keys of files: one row for each, whatever the format of the file.

A table of keys is written out, or derived from a class whose arguments are the keys.
"""

from __future__ import annotations

import inspect
import math
import re
import reprlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ..protocol.checks import choice, integer, shown
from ..protocol.mistakes import Path, WrongType, WrongValue, close_option, inside, item
from .texts import shown_key

Check = Callable[[Path, object], Any]
"""Checks the value of the key at a path, and returns the converted value."""

REQUIRED: Any = inspect.Parameter.empty
"""The default of a required key."""


def anything(path: Path, value: object) -> object:
    """Return a value unchecked, because it is checked elsewhere."""
    return value


@dataclass(frozen=True)
class Key:
    """One key of a table in a file; `text` says what it means."""

    name: str
    check: Check = anything
    text: str = ""
    default: Any = None  # `REQUIRED` if the key is required
    kind: str = ""  # the annotation of its value, such as "int"; empty if that is not known


class Keys(dict[str, Key]):
    """All keys of one table in a file, by name; `make` is called with their values."""

    def __init__(self, keys: Iterable[Key], make: Callable[..., Any] = dict) -> None:
        super().__init__({key.name: key for key in keys})
        self._make = make

    def but(self, *names: str) -> Keys:
        """Return all keys except some; reading them returns a dict."""
        return Keys(key for key in self.values() if key.name not in names)

    def only(self, *names: str) -> Keys:
        """Return the existing ones of some keys; reading them returns a dict."""
        return Keys(key for key in self.values() if key.name in names)

    def optional(self) -> Keys:
        """Return the same keys, none of them required; reading them returns a dict."""
        return Keys(
            replace(key, default=None) if key.default is REQUIRED else key for key in self.values()
        )

    def __or__(self, other: Mapping[str, Key]) -> Keys:  # type: ignore[override]
        return Keys({**self, **other}.values())

    def read(self, path: Path, content: object) -> Any:
        """Return the result of `make` for the checked values; errors have the path of a key."""
        values = table(path, content)
        for name in values:
            if name not in self:
                close = close_option(name, self)
                reason = f"no such key; allowed are {', '.join(self)}{close}"
                raise WrongValue.about((*path, shown_key(name)), reason)
        for key in self.values():
            if key.default is REQUIRED and key.name not in values:
                raise WrongValue((*path, key.name), "is missing")
        values = {name: self[name].check((*path, name), value) for name, value in values.items()}
        with inside(*path):
            return self._make(**values)


def keys_of(make: Callable[..., Any], **checks: Check) -> Keys:
    """Return the arguments of a class as keys; the class checks values without `checks`."""
    keys = [
        Key(name, checks.get(name, anything), default=entry.default, kind=str(entry.annotation))
        for name, entry in inspect.signature(make).parameters.items()
    ]
    return Keys(keys, make)


def whole(low: int, high: int) -> Check:
    """Return a check for integers in a range."""
    return lambda path, value: integer(path, value, low, high)


def _of_kind(kind: type, what: str) -> Check:
    def check(path: Path, value: object) -> Any:
        if not isinstance(value, kind):
            raise WrongType(path, f"must be {what}, not {reprlib.repr(value)}")
        return value

    return check


text: Check = _of_kind(str, "text")
flag: Check = _of_kind(bool, "true or false")
table: Check = _of_kind(dict, "a table")
a_list: Check = _of_kind(list, "a list")


def tables(path: Path, value: object) -> list[dict[str, object]]:
    """Check an array of tables."""
    if not isinstance(value, list):
        name = ".".join(part for part in path if isinstance(part, str))
        raise WrongType(path, f"must be a list of tables: [[{name}]]")
    return [table(item(path, at), entry) for at, entry in enumerate(value)]


def bytes_or_text(low: int, high: int) -> Check:
    """Return a check for bytes within a length: ASCII text, or a list of numbers."""

    def check(path: Path, value: object) -> bytes:
        if isinstance(value, list):
            numbers = enumerate(value)
            data = bytes(integer(item(path, at), number, 0, 255) for at, number in numbers)
        elif isinstance(value, str) and value.isascii():
            data = value.encode("ascii")
        else:
            raise WrongType(path, f"must be ASCII text or a list of bytes, not {shown(value)}")
        if not low <= len(data) <= high:
            raise WrongValue(path, f"must have {low}..{high} bytes, not {len(data)}")
        return data

    return check


def one_of(*choices: str) -> Check:
    """Return a check for one of some words."""
    return lambda path, value: choice(path, value, choices)


# --- amounts with their units, such as "90 days" and "2 GB" ---------------------------------------


_SECONDS: dict[str, int] = {
    **dict.fromkeys(("s", "second", "seconds"), 1),
    **dict.fromkeys(("min", "minute", "minutes"), 60),
    **dict.fromkeys(("h", "hour", "hours"), 3600),
    **dict.fromkeys(("d", "day", "days"), 86_400),
    **dict.fromkeys(("week", "weeks"), 7 * 86_400),
    **dict.fromkeys(("year", "years"), 365 * 86_400),
}

_BYTES: dict[str, int] = {
    "B": 1,
    **{f"{letter}B": 1000**power for power, letter in enumerate("kMGT", start=1)},
    **{f"{letter}iB": 1024**power for power, letter in enumerate("KMGT", start=1)},
}

_AMOUNT = re.compile(r"\s*([0-9]{1,15}(?:\.[0-9]{1,9})?)\s*([A-Za-z]+)\s*")


def in_seconds(name: str | Path, text: object, low: str, high: str) -> float:
    """Return the seconds of an amount of time, such as "90 days", within two amounts."""
    return _amount(name, text, _SECONDS, low, high, "a time")


def in_bytes(name: str | Path, text: object, low: str, high: str) -> int:
    """Return the bytes of a size, such as "2 GB" or "512 MiB"; otherwise as `in_seconds`."""
    return int(_amount(name, text, _BYTES, low, high, "a size"))


def _amount(
    name: str | Path, text: object, units: dict[str, int], low: str, high: str, what: str
) -> float:
    rule = f'must be {what} in "{low}".."{high}"'
    if not isinstance(text, str):
        raise WrongType(name, f"{rule}, not {type(text).__name__}")
    amount = _in_units(text, units)
    if not _in_units(low, units) <= amount <= _in_units(high, units):
        raise WrongValue(name, f"{rule}, not {text[:40]!r}")
    return amount


def _in_units(text: str, units: dict[str, int]) -> float:
    """Return an amount in its smallest unit; nan for another text."""
    match = _AMOUNT.fullmatch(text)
    return float(match[1]) * units.get(match[2], math.nan) if match else math.nan
