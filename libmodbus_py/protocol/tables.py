"""
The four tables of a device: what they hold, how much of it a request may carry, and ranges of
their addresses.

Ranges are "joined" if they are in ascending order, none is empty, and none touches the next one.
"""

from __future__ import annotations

import reprlib
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Collection, Iterable, Sequence
from operator import attrgetter
from typing import Any, Literal, NamedTuple, get_args

from . import pdu
from .checks import choice, integer, string
from .mistakes import WrongValue
from .pdu.request import MAX_WRITTEN, checked_span
from .pdu.request import TABLE_SIZE as TABLE_SIZE
from .words import TABLE_WORDS, close_word, table_named

WritableTable = Literal["holding_registers"]
RegisterTable = Literal[WritableTable, "input_registers"]
Table = Literal["coils", "discrete_inputs", RegisterTable]

WriteFunction = Literal["auto", "single", "multiple"]
"""
The functions that write values: 5 and 6 for each cell ("single"), 15 and 16 ("multiple"); or the
first for one cell and the others for several ("auto").
"""


class TableRules(NamedTuple):
    """The request that reads a table, and the most cells of one request; 0 of read-only ones."""

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


def checked_table(table: object, names: Collection[str] = TABLES.keys()) -> Any:
    """Return the name of a table, which may be written as vendors do, such as "hr" or "4x"."""
    name = table_named(table)
    if name not in names:
        words = [word for word, meaning in TABLE_WORDS.items() if meaning in names]
        close = close_word(table, names, words)
        raise WrongValue("table", f"must be one of {', '.join(names)}, not {table!r}{close}")
    return name


def checked_values(address: int, count: int, size: int) -> tuple[int, int]:
    """Return the address and the number of values of `size` cells, which a table must hold."""
    count = integer("count", count, 1, TABLE_SIZE // size)
    name = "count" if size == 1 else f"{size} * count"
    return checked_span("address", address, name, count * size), count


def checked_write_function(value: object) -> Any:
    """Return a value that is allowed, or raise ValueError."""
    return choice("write_function", value, get_args(WriteFunction))


def register_table(table: object) -> Any:
    """Return the name of a table of registers; a TypeError or ValueError if it is none."""
    return checked_table(string("table", table), REGISTER_TABLES)


def check_writable(table: object) -> None:
    """Raise a TypeError or ValueError for any other table than that of holding registers."""
    if table != "holding_registers" and table_named(string("table", table)) != "holding_registers":
        raise WrongValue("table", f"must be holding_registers, not {table!r}")


# --- ranges of addresses -------------------------------------------------------------------

START = attrgetter("start")


def checked_ranges(
    name: str, value: Any, form: str = "a range of addresses or a list of ranges"
) -> list[range]:
    """Return an argument that is a range, or several, as ranges of step 1 in ascending order."""
    is_one = isinstance(value, range) or not isinstance(value, Iterable)
    ranges: list[Any] = [value] if is_one else list(value)
    if not all(isinstance(span, range) for span in ranges):
        raise TypeError(f"{name} must be {form}, not {reprlib.repr(value)}")
    for span in ranges:
        if span.step != 1 or span.start < 0 or (span and span[-1] >= TABLE_SIZE):
            raise ValueError(f"{name} must be within 0..{TABLE_SIZE - 1}, step 1, not {span}")
    return sorted(ranges, key=START)


def joined(ranges: Iterable[range]) -> tuple[range, ...]:
    """Return ranges of step 1 in ascending order, without empty ones, and joined."""
    result: list[range] = []
    for addresses in sorted(filter(None, ranges), key=START):
        if result and addresses.start <= result[-1].stop:
            result[-1] = range(result[-1].start, max(result[-1].stop, addresses.stop))
        else:
            result.append(addresses)
    return tuple(result)


def contains(ranges: Sequence[range], address: int, count: int = 1) -> bool:
    """Return True if joined ranges contain `count` addresses from `address` on."""
    at = bisect_right(ranges, address, key=START) - 1
    return at >= 0 and address + count <= ranges[at].stop


def touches(ranges: Sequence[range], address: int, count: int = 1) -> bool:
    """Return True if joined ranges contain any of `count` addresses from `address` on."""
    at = bisect_left(ranges, address + count, key=START) - 1
    return at >= 0 and address < ranges[at].stop


def without(ranges: Iterable[range], others: Sequence[range]) -> tuple[range, ...]:
    """Return the parts of joined ranges that are in none of other joined ranges."""
    result: list[range] = []
    for addresses in ranges:
        start = addresses.start
        at = max(bisect_right(others, start, key=START) - 1, 0)
        while at < len(others) and others[at].start < addresses.stop:
            result.append(range(start, others[at].start))
            start = max(start, others[at].stop)
            at += 1
        result.append(range(start, addresses.stop))
    return tuple(filter(None, result))
