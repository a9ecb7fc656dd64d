"""
The keys of files: one row for each, whatever the format of the file.

A table of keys is written out, or derived from a class whose arguments are the keys; then names and
defaults come from the signature of the class, and texts from its docstring.
"""

from __future__ import annotations

import inspect
import re
import reprlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ...device.access import Access
from ...device.authorization import Allow, Rules
from ...protocol.checks import integer, shown
from ...protocol.mistakes import Path, WrongType, WrongValue, close_option, inside, item
from .texts import shown_key

# fmt: off
__all__ = [
    "REQUIRED", "Check", "Key", "Keys", "a_list", "anything", "bytes_or_text", "flag", "in_bytes",
    "in_seconds", "keys_of", "one_of", "parts_of_tables", "roles", "table", "tables", "text",
    "whole",
]
# fmt: on

Check = Callable[[Path, object], Any]
"""Function that checks the value of the key at a path, and returns the converted value."""

REQUIRED: Any = inspect.Parameter.empty
"""The default of a required key."""


def anything(path: Path, value: object) -> object:
    """Return a value unchecked, because it is checked elsewhere."""
    return value


@dataclass(frozen=True)
class Key:
    """
    One key of a table in a file.

    Attributes:
        name: the key.
        check: checks the value.
        text: what the key means.
        default: the value if the key is missing; `REQUIRED` if the key is required.
        kind: the annotation of its value, such as "int"; empty if that is not known.
    """

    name: str
    check: Check = anything
    text: str = ""
    default: Any = None
    kind: str = ""


class Keys(Mapping[str, Key]):
    """
    All keys of one table in a file, by name.

    Args:
        keys: in the order in which errors name them.
        make: called with the values; by default they become a dict.
    """

    def __init__(self, keys: Iterable[Key], make: Callable[..., Any] = dict) -> None:
        self._keys = {key.name: key for key in keys}
        self._make = make

    def __getitem__(self, name: str) -> Key:
        return self._keys[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._keys)

    def __len__(self) -> int:
        return len(self._keys)

    def but(self, *names: str) -> Keys:
        """Return all keys but these; reading them returns a dict."""
        return Keys(key for key in self.values() if key.name not in names)

    def only(self, *names: str) -> Keys:
        """Return those of these keys that exist; reading them returns a dict."""
        return Keys(key for key in self.values() if key.name in names)

    def optional(self) -> Keys:
        """Return the same keys, none of them required; reading them returns a dict."""
        return Keys(
            replace(key, default=None) if key.default is REQUIRED else key for key in self.values()
        )

    def __or__(self, other: Keys) -> Keys:
        return Keys((self._keys | other._keys).values())

    def read(self, path: Path, given: object) -> Any:
        """
        Check a table, and return the result of `make` for its values.

        Raises:
            TypeError, ValueError: `given` is not a table, a key is missing or unknown, or has
                    a wrong value; with the path of the key.
        """
        found = self.checked(path, table(path, given))
        with inside(*path):
            return self._make(**found)

    def checked(self, path: Path, given: Mapping[str, object]) -> dict[str, Any]:
        """
        Check the keys of a table and their values.

        Raises:
            TypeError, ValueError: as `read`.
        """
        for name in given:
            if name not in self._keys:
                close = close_option(name, self._keys)
                reason = f"no such key; allowed are {', '.join(self._keys)}{close}"
                raise WrongValue.about((*path, shown_key(name)), reason)
        for key in self._keys.values():
            if key.default is REQUIRED and key.name not in given:
                raise WrongValue((*path, key.name), "is missing")
        return {name: self._keys[name].check((*path, name), value) for name, value in given.items()}


def keys_of(make: Callable[..., Any], **checks: Check) -> Keys:
    """
    Return the arguments of a class as keys; the class checks all values but those of `checks`.

    Texts are those of the section "Args" or "Attributes" of the docstring of the class.
    """
    texts = _texts(inspect.getdoc(make) or "")
    return Keys(
        (
            Key(
                each.name,
                checks.get(each.name, anything),
                texts.get(each.name, ""),
                each.default,
                str(each.annotation),
            )
            for each in inspect.signature(make).parameters.values()
        ),
        make,
    )


def _texts(docstring: str) -> dict[str, str]:
    """Return the text of each argument in a section; several arguments may share one text."""
    found: dict[str, str] = {}
    section = re.search(r"^(?:Args|Attributes):\n((?:    .*\n?|\n)*)", docstring, re.MULTILINE)
    for entry in re.split(r"\n(?=    \w)", section[1] if section else ""):
        names, _, text = entry.strip().partition(":")
        found |= dict.fromkeys(names.split(", "), " ".join(text.split()))
    return found


# --- checks ----------------------------------------------------------------------------


def whole(low: int, high: int) -> Check:
    """Return a check for integers in a range."""
    return lambda path, value: integer(path, value, low, high)


def _of_kind(kind: type, what: str) -> Check:
    def check(path: Path, value: object) -> Any:
        if not isinstance(value, kind):
            raise WrongType(path, f"must be {what}, not {reprlib.repr(value)}")
        return value

    return check


flag: Check = _of_kind(bool, "true or false")
table: Check = _of_kind(dict, "a table")
a_list: Check = _of_kind(list, "a list")


def tables(path: Path, value: object) -> list[dict[str, object]]:
    """Check an array of tables."""
    if not isinstance(value, list):
        name = ".".join(each for each in path if isinstance(each, str))
        raise WrongType(path, f"must be a list of tables: [[{name}]]")
    return [table(item(path, at), each) for at, each in enumerate(value)]


def text(most: int) -> Check:
    """Return a check for texts of at most this many characters."""

    def check(path: Path, value: object) -> str:
        if not isinstance(value, str):
            raise WrongType(path, f"must be text, not {shown(value)}")
        if len(value) > most:
            raise WrongValue(path, f"must have 0..{most} characters, not {len(value)}")
        return value

    return check


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

    def check(path: Path, value: object) -> str:
        if value not in choices:
            raise WrongValue(path, f"must be one of {', '.join(choices)}, not {shown(value)}")
        return str(value)

    return check


# --- amounts with their units, such as "90 days" and "2 GB" ---------------------------------------


_MINUTE, _HOUR, _DAY = 60, 3600, 86_400

_SECONDS: dict[str, int] = {
    **dict.fromkeys(("s", "second", "seconds"), 1),
    **dict.fromkeys(("min", "minute", "minutes"), _MINUTE),
    **dict.fromkeys(("h", "hour", "hours"), _HOUR),
    **dict.fromkeys(("d", "day", "days"), _DAY),
    **dict.fromkeys(("week", "weeks"), 7 * _DAY),
    **dict.fromkeys(("year", "years"), 365 * _DAY),
}

_BYTES: dict[str, int] = {
    "B": 1,
    "kB": 10**3,
    "MB": 10**6,
    "GB": 10**9,
    "TB": 10**12,
    "KiB": 1 << 10,
    "MiB": 1 << 20,
    "GiB": 1 << 30,
    "TiB": 1 << 40,
}

_AMOUNT = re.compile(r"\s*([0-9]{1,15}(?:\.[0-9]{1,9})?)\s*([A-Za-z]+)\s*")


def in_seconds(name: str | Path, text: object, low: str, high: str) -> float:
    """
    Return the seconds of an amount of time, such as "90 days" or "36 h".

    Args:
        name: the argument, or the path of the key.
        text: the amount.
        low, high: the smallest and the greatest amount that are allowed.

    Raises:
        TypeError: not a text.
        ValueError: not an amount of time, or out of range.
    """
    return _amount(name, text, _SECONDS, low, high, "a time")


def in_bytes(name: str | Path, text: object, low: str, high: str) -> int:
    """Return the bytes of a size, such as "2 GB" or "512 MiB"; otherwise as `in_seconds`."""
    return int(_amount(name, text, _BYTES, low, high, "a size"))


def _amount(
    name: str | Path, text: object, units: dict[str, int], low: str, high: str, what: str
) -> float:
    allowed = f'must be {what} in "{low}".."{high}"'
    if not isinstance(text, str):
        raise WrongType(name, f"{allowed}, not {type(text).__name__}")
    amount = _read(text, units)
    bounds = _read(low, units), _read(high, units)
    if amount is None or bounds[0] is None or bounds[1] is None:
        raise WrongValue(name, f"{allowed}, not {text[:40]!r}")
    if not bounds[0] <= amount <= bounds[1]:
        raise WrongValue(name, f"{allowed}, not {text[:40]!r}")
    return amount


def _read(text: str, units: dict[str, int]) -> float | None:
    found = _AMOUNT.fullmatch(text)
    if found is None or found[2] not in units:
        return None
    return float(found[1]) * units[found[2]]


# --- roles: [roles.NAME], with the arguments of Allow ---------------------------------------------


def roles(path: Path, given: object) -> Rules:
    """
    Return the rules of all roles; the empty name stands for clients without a role.

    A unit without rules of its own has those of the file, which are passed ready-made.

    Raises:
        TypeError, ValueError: a table is not a rule; with the path of the key.
    """
    if isinstance(given, Rules):
        return given
    named = table(path, given)
    found = {
        name or None: ALLOW.read((*path, shown_key(name)), each) for name, each in named.items()
    }
    with inside(*path):
        return Rules(found)


def parts_of_tables(path: Path, given: object) -> Any:
    """
    Return names of tables, and an `Access` for each part of a table.

    Raises:
        TypeError, ValueError: a part has a missing or an unknown key.
    """
    if not isinstance(given, list):
        return given
    return [
        PART.read(item(path, at), each) if isinstance(each, dict) else each
        for at, each in enumerate(given)
    ]


ALLOW = keys_of(Allow, read=parts_of_tables, write=parts_of_tables)

PART = Keys(
    (
        Key("table", anything, "the table", REQUIRED),
        Key("address", anything, "the first address or record", REQUIRED),
        Key("count", anything, "how many", REQUIRED),
        Key("file", anything, "the number of the file", 0),
    ),
    Access,
)
