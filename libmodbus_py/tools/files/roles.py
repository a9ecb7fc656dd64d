"""
The tables ``[roles.NAME]`` of files: the access rights of clients by role.

Their keys are the arguments of `Allow`; parts of tables are TOML tables with the attributes an
`Access` has.
"""

from __future__ import annotations

from typing import Any

from ...device.access import Access
from ...device.rules import Allow, Rules
from ...protocol.mistakes import Path, inside, item
from .schema import REQUIRED, Key, Keys, anything, keys_of, table
from .texts import shown_key

__all__ = ["parts", "rules"]


def rules(path: Path, given: object) -> Rules:
    """
    Return the rules of all roles; the empty name stands for clients without a role.

    A unit without rules of its own has those of the file, which are passed ready-made.

    Raises:
        TypeError, ValueError: a table is not a rule; with the path of the key.
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
