"""
The tables ``[roles.NAME]`` of files: who may read and write what.

What stands in them is what `Allow` takes; parts of tables are TOML tables with what an
`Access` has.
"""

from __future__ import annotations

from typing import Any

from ...device.access import Access
from ...device.rules import Allow, Rules
from ...protocol.mistakes import Path, inside, item
from .schema import REQUIRED, Key, Keys, anything, keys_of, table
from .toml_lines import shown_key

__all__ = ["parts", "rules"]


def rules(path: Path, given: object) -> Rules:
    """
    Make the rules of all roles; the empty name is that of clients without a role.

    Rules that were made already, those of the file, are those of a unit that has none.

    Raises:
        TypeError, ValueError: a table is no rule; with the path of the key.
    """
    if isinstance(given, Rules):
        return given
    named = table(path, given)
    roles = {
        name or None: ALLOW.read((*path, shown_key(name)), each) for name, each in named.items()
    }
    with inside(*path):
        return Rules(roles)


def parts(path: Path, given: object) -> Any:
    """
    Make a list of names of tables, and of an `Access` for each part of a table.

    Raises:
        TypeError, ValueError: a part has a key missing, or one that means nothing.
    """
    if not isinstance(given, list):
        return given
    return [
        PART.read(item(path, at), each) if isinstance(each, dict) else each
        for at, each in enumerate(given)
    ]


ALLOW = keys_of(Allow, read=parts, write=parts)

PART = Keys(
    (
        Key("table", anything, "the table", REQUIRED),
        Key("address", anything, "the first address or record", REQUIRED),
        Key("count", anything, "how many", REQUIRED),
        Key("file", anything, "the number of the file", 0),
    ),
    Access,
)
