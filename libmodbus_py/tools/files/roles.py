"""
The tables ``[roles.NAME]`` of files: who may read and write what.

What stands in them is what `Allow` takes; parts of tables are TOML tables with what an
`Access` has.
"""

from __future__ import annotations

from typing import Any

from ...device.access import Access
from ...device.rules import Allow, Rules
from .tables import checked_table
from .toml_lines import below

__all__ = ["part", "rules"]

RIGHTS = ("read", "write", "functions")

PART = ("table", "address", "count", "file")


def rules(where: str, given: object) -> Rules:
    """
    Make the rules of all roles; the empty name is that of clients without a role.

    Rules that were made already, those of the file, are those of a unit that has none.

    Raises:
        TypeError, ValueError: it says what cannot be; the message begins with its key.
    """
    if isinstance(given, Rules):
        return given
    named = checked_table(where, given)
    roles = {name or None: _allow(below(where, name), each) for name, each in named.items()}
    try:
        return Rules(roles)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _allow(where: str, given: object) -> Allow:
    rights = checked_table(where, given, RIGHTS)
    converted = {
        name: [part(below(f"{where}.{name}", at), each) for at, each in enumerate(value)]
        if isinstance(value, list)
        else value
        for name, value in rights.items()
    }
    try:
        return Allow(**converted)
    except (TypeError, ValueError) as error:
        raise type(error)(f"{where}.{error}") from None


def part(where: str, given: object) -> Any:
    """
    Make an `Access` of a part of a table; the name of a whole one stays as it is.

    Raises:
        TypeError, ValueError: it begins with `where`.
    """
    if not isinstance(given, dict):
        return given
    part = checked_table(where, given, PART)
    for key in PART[:3]:
        if key not in part:
            raise ValueError(f"{where}.{key} is missing")
    return Access(**part)
