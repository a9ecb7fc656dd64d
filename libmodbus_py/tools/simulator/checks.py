"""
Checks of what stands in a device file; what is wrong is told with its key.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, fields
from typing import Any

from ...protocol.checks import integer, shown
from ..files.toml_lines import shown_key

# fmt: off
__all__ = [
    "Check", "DeviceFileError", "a_list", "anything", "bytes_or_text", "checked", "flag", "inside",
    "made_by", "one_of", "table", "tables", "text", "whole",
]
# fmt: on

# Checks a value, whose name is given for the error, and gives what it stands for.
Check = Callable[[str, object], Any]


class DeviceFileError(ValueError):
    """
    A device file that cannot be: which file, line and key, and what is allowed.

    Attributes:
        files: the register maps that were read, or could not be.
    """

    files: tuple[str, ...] = ()


@contextlib.contextmanager
def inside(where: str) -> Iterator[None]:
    """Say where it was, unless the message says it itself."""
    try:
        yield
    except DeviceFileError:
        raise
    except (TypeError, ValueError) as error:
        raise DeviceFileError(f"{where}{error}") from None


def checked(
    where: str,
    given: Mapping[str, object],
    allowed: Mapping[str, Check],
    required: Iterable[str] = (),
) -> dict[str, Any]:
    """Check the keys of a TOML table and their values; `where` ends with a dot, or is empty."""
    for key in given:
        if key not in allowed:
            raise DeviceFileError(
                f"{where}{shown_key(key)}: no such key; allowed are {', '.join(allowed)}"
            )
    for key in required:
        if key not in given:
            raise DeviceFileError(f"{where}{key} is missing")
    with inside(""):
        return {key: allowed[key](f"{where}{key}", value) for key, value in given.items()}


def whole(low: int, high: int) -> Check:
    return lambda name, value: integer(name, value, low, high)


def a_kind_of(kind: type, what: str) -> Check:
    def check(name: str, value: object) -> Any:
        if not isinstance(value, kind):
            raise TypeError(f"{name} must be {what}, not {shown(value)}")
        return value

    return check


flag: Check = a_kind_of(bool, "true or false")
table: Check = a_kind_of(dict, "a table")
a_list: Check = a_kind_of(list, "a list")


def tables(name: str, value: object) -> list[dict[str, object]]:
    if not isinstance(value, list):
        raise TypeError(f"{name} must be a list of tables: [[{re.sub('[^a-z._]', '', name)}]]")
    return [table(f"{name}[{at}]", each) for at, each in enumerate(value)]


def text(most: int) -> Check:
    def check(name: str, value: object) -> str:
        found = str(a_kind_of(str, "text")(name, value))
        if len(found) > most:
            raise ValueError(f"{name} must have 0..{most} characters, not {len(found)}")
        return found

    return check


def anything(name: str, value: object) -> object:
    return value


def bytes_or_text(low: int, high: int) -> Check:
    """Text, or a list of bytes for what is none."""

    def check(name: str, value: object) -> bytes:
        if isinstance(value, list):
            numbers = enumerate(value)
            data = bytes(integer(f"{name}[{at}]", number, 0, 255) for at, number in numbers)
        elif isinstance(value, str) and value.isascii():
            data = value.encode("ascii")
        else:
            raise TypeError(f"{name} must be ASCII text or a list of bytes, not {shown(value)}")
        if not low <= len(data) <= high:
            raise ValueError(f"{name} must have {low}..{high} bytes, not {len(data)}")
        return data

    return check


def one_of(*choices: str) -> Check:
    def check(name: str, value: object) -> str:
        if value not in choices:
            raise ValueError(f"{name} must be one of {', '.join(choices)}, not {shown(value)}")
        return str(value)

    return check


def made_by(make: Callable[..., Any], **checks: Check) -> Check:
    """A dataclass that checks itself, but for these: its attributes are the keys."""
    attributes = fields(make)  # type: ignore[arg-type]
    allowed = {attribute.name: checks.get(attribute.name, anything) for attribute in attributes}
    required = [attribute.name for attribute in attributes if attribute.default is MISSING]

    def check(name: str, value: object) -> Any:
        given = checked(f"{name}.", table(name, value), allowed, required)
        with inside(f"{name}."):
            return make(**given)

    return check
