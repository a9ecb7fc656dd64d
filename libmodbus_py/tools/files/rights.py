"""
The rights of roles in files of devices and gateways: a table for each role, with tables, parts of
tables, and functions::

    [roles.Operator]
    read = "all"
    write = ["coils", { table = "holding_registers", address = 100, count = 20 }]

The keys of a role are the arguments of `Allow`, and those of a part of a table some of `Access`.
"""

from __future__ import annotations

from typing import Any

from ...device.access import Access
from ...device.authorization import Allow, Rules
from ...files.schema import REQUIRED, Key, Keys, anything, keys_of, table
from ...files.texts import shown_key
from ...protocol.mistakes import Path, inside, item

__all__ = ["parts_of_tables", "roles"]


def roles(path: Path, given: object) -> Rules:
    """
    Return the rules of all roles; the empty name stands for clients without a role.

    Raises:
        TypeError, ValueError: a role has a wrong name or key; the message has the path of it.
    """
    if isinstance(given, Rules):  # those of the file, for a unit without its own
        return given
    named = table(path, given)
    found = {
        name or None: ALLOW.read((*path, shown_key(name)), each) for name, each in named.items()
    }
    with inside(*path):
        return Rules(found)


def parts_of_tables(path: Path, given: object) -> Any:
    """Return names of tables, and an `Access` for each part of a table."""
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
