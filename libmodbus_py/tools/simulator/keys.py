"""
The keys of device files, and the checks of their values.

``docs/how-to/simulator.md`` explains them all; a test holds it to these tables.
"""

from __future__ import annotations

from ...protocol.checks import integer
from ...protocol.mistakes import Path, WrongValue
from ...protocol.pdu import RECORDS_PER_FILE
from ...protocol.tables import TABLES
from ..faults.fault import LONGEST, Fault
from ..files.map_contents import POINT
from ..files.schema import (
    REQUIRED,
    Key,
    Keys,
    a_list,
    bytes_or_text,
    flag,
    keys_of,
    roles,
    table,
    tables,
    text,
    whole,
)
from .behaviour import BEHAVIOURS

# fmt: off
__all__ = [
    "CONTENTS", "DEFAULTS", "FAULT", "FIFO", "FILE", "MOVES", "POINT_KEYS", "SERVER_ID", "TYPING",
    "UNIT", "VALUES",
]
# fmt: on


def _unit_id(path: Path, value: object) -> int:
    number = integer(path, value, 0, 255)
    if 247 < number < 255:
        raise WrongValue(path, f"must be in 0..247, or 255, not {number}")
    return number


def _maps(path: Path, value: object) -> list[tuple[Path, str]]:
    """Check one path of a register map, or several; return each with its own place."""
    found = [((*path, at), name) for at, name in enumerate(value)] if type(value) is list else []
    for where, name in found or [(path, value)]:
        if not isinstance(name, str):
            raise WrongValue(where, "must be the path of a register map, or a list of them")
    return found or [(path, str(value))]


FAULT = keys_of(Fault, data=bytes_or_text(0, LONGEST))

MOVES = Keys(Key(name, keys_of(make).read) for name, make in BEHAVIOURS.items())
"""How values change."""

VALUES = Keys(
    [
        Key("value", text="the initial value of all"),
        Key("values", a_list, "the initial value of each, in place of `value` and `count`"),
    ]
)

POINT_KEYS = POINT.but("table")
"""The keys of a point; the name of the list is its table."""

TYPING = POINT.only("type", "order", "encoding", "padding")

DEFAULTS = (TYPING | POINT.only("access")).optional()

_IN_TABLE = (
    POINT_KEYS.optional()
    | POINT.only("address")
    | Keys([Key("count", whole(1, 0x10000))])
    | VALUES
    | MOVES
)

CONTENTS: dict[str, Keys] = {
    **dict.fromkeys(TABLES, _IN_TABLE),
    "file": Keys(
        [
            Key("number", whole(1, 0xFFFF), "the number of the file", REQUIRED),
            Key("record", whole(0, RECORDS_PER_FILE - 1), "the first record", REQUIRED),
            Key("count", whole(1, RECORDS_PER_FILE)),
        ]
    )
    | VALUES
    | TYPING
    | POINT.only("access"),
}
"""Table -> the keys of its points or records."""

SERVER_ID = Keys(
    [
        Key("identifier", bytes_or_text(1, 125), "the identifier of the device"),
        Key("running", flag, "the run indicator"),
        Key("additional", bytes_or_text(0, 125), "additional data"),
    ]
)

FIFO = Keys(
    [
        Key("address", whole(0, 0xFFFF), "the address of the queue", REQUIRED),
        Key("values", a_list, "up to 31 registers, oldest first", REQUIRED),
    ]
)

UNIT = Keys(
    [
        Key("id", _unit_id, "0..247 or 255; a single unit without an id answers for every unit"),
        Key("name", text(100), "a name, for people"),
        Key("description", text(250), "a description, for people"),
        Key("exception_status", whole(0, 255), "the response to function 7"),
        Key("server_id", SERVER_ID.read, "the response to function 17"),
        Key("identification", table, "the response to function 43/14"),
        Key("defaults", table, "keys of all points of the unit, unless a point has its own"),
        Key("map", _maps, "paths of register maps; the device has all their points"),
        Key("values", table, "initial values of points of the maps, by name"),
        Key("moves", table, "how points of the maps change, by name"),
        *(Key(name, tables, "a table for each point, or run of records") for name in CONTENTS),
        Key("fifo", tables, "a table for each queue"),
        Key("fault", tables, "a table for each fault"),
        Key("roles", roles, "what each role may read and write, in this unit"),
    ]
)

FILE = Keys(
    [
        Key("unit", tables, "a table for each unit", REQUIRED),
        Key("fault", tables, "a table for each fault of all units"),
        Key("roles", roles, "what each role may read and write: [roles.NAME]"),
        Key("defaults", table, "keys of all points, unless their unit or they have their own"),
    ]
)
