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


def roles(path: Path, value: object) -> Rules:
    """
    Return the rules of all roles; the empty name stands for clients without a role.

    Raises:
        TypeError, ValueError: a role has a wrong name or key; the message has the path of it.
    """
    if isinstance(value, Rules):  # those of the file, for a unit without its own
        return value
    tables = table(path, value)
    rules = {
        name or None: ALLOW.read((*path, shown_key(name)), texts) for name, texts in tables.items()
    }
    with inside(*path):
        return Rules(rules)


def parts_of_tables(path: Path, value: object) -> Any:
    """Return names of tables, and an `Access` for each part of a table."""
    if not isinstance(value, list):
        return value
    return [
        PART.read(item(path, at), part) if isinstance(part, dict) else part
        for at, part in enumerate(value)
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
