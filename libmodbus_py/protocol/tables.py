"""
The four tables of a device: what they hold, and how much of it a request may carry.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

from . import pdu
from .mistakes import WrongValue
from .pdu.fields import MAX_WRITTEN, TABLE_SIZE
from .words import TABLE_WORDS, close_word, table_named

# fmt: off
__all__ = [
    "REGISTER_TABLES", "TABLES", "TABLE_SIZE", "RegisterTable", "Table", "WritableTable",
    "checked_table",
]
# fmt: on

WritableTable = Literal["holding_registers"]
RegisterTable = Literal[WritableTable, "input_registers"]
Table = Literal["coils", "discrete_inputs", RegisterTable]


class TableRules(NamedTuple):
    """
    The rules of one table; all have the addresses 0..65535 (`TABLE_SIZE`).

    Attributes:
        read: makes the request for some of it: (address, count).
        is_bits: whether its cells are True and False, not 0..65535.
        most_read: the most cells of one read.
        most_written: the most cells of one write; 0 if clients can only read it.
    """

    read: Callable[[int, int], pdu.Request[list[Any]]]
    is_bits: bool
    most_read: int
    most_written: int = 0


TABLES: dict[str, TableRules] = {
    name: TableRules(read, is_bits, read.limit, MAX_WRITTEN.get(name, 0))
    for name, read, is_bits in (
        ("coils", pdu.ReadCoils, True),
        ("discrete_inputs", pdu.ReadDiscreteInputs, True),
        ("holding_registers", pdu.ReadHoldingRegisters, False),
        ("input_registers", pdu.ReadInputRegisters, False),
    )
}
"""Name -> rules; the names are those of `Table`."""

REGISTER_TABLES = [name for name, rules in TABLES.items() if not rules.is_bits]
"""The names of `RegisterTable`."""


def checked_table(table: object) -> Any:
    """
    Return the name of a table, which may be written as vendors do, such as "hr" or "4x".

    Raises:
        WrongValue: there is no such table.
    """
    name = table_named(table)
    if name is None:
        close = close_word(table, TABLES, TABLE_WORDS)
        raise WrongValue("table", f"must be one of {', '.join(TABLES)}, not {table!r}{close}")
    return name
