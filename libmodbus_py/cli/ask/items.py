"""
Items that are read or written: tables and addresses, references, names; as words and requests.

::

    hr 100    40101    voltage      a cell of a table, a reference, a point of a map
    hr 100:float32                  a type for this item, in place of --type
    hr 100-105    40101-40106       a range of cells
    40101=5    hr 100=5             a value behind it, for a write
"""

from __future__ import annotations

import argparse
import re
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from ...maps.plan import Plan, Read
from ...protocol import pdu
from ...protocol.errors import IllegalDataAddress, ModbusError
from ...protocol.plain import number_of
from ...protocol.tables import TABLE_SIZE, TABLES
from ...protocol.values import ValueType, parse_reference, value_type
from ...protocol.words import TABLE_WORDS as VENDORS
from ...protocol.words import close_word, plain, table_named
from ..failing import advice

if TYPE_CHECKING:
    from ...maps.point import Point
    from ...maps.register_map import RegisterMap

# fmt: off
__all__ = [
    "ALL", "REGISTERS", "TABLE_WORDS", "Cells", "Item", "ItemPlan", "Words", "map_of", "reason_of",
]
# fmt: on

TABLE_WORDS = {
    "coils": "coils",
    "discrete": "discrete_inputs",
    "holding": "holding_registers",
    "input": "input_registers",
    "file": "file",
    "fifo": "fifo_queue",
}
"""Word on the command line -> name of the table; `protocol.words` has more for the first four."""

WORD_OF = {table: word for word, table in TABLE_WORDS.items()}

# Sections 6.14 and 6.15; the answer to 6.18 has as many as there are.
REGISTERS = {
    name: (rules.most_read, rules.most_written)
    for name, rules in TABLES.items()
    if not rules.is_bits
} | {"file": (124, 122)}
"""Table of registers -> the most that one request reads, and writes."""

USUAL_RECORDS = 121
"""Records of a request; the byte count of an answer goes to 245 (section 6.14), although 251 would
fit, so that longer requests are sent only for a count that asks for them."""

USUAL = {"order": "ABCD", "encoding": "ascii", "padding": "\0"}
"""Options of a type -> their defaults."""

ALL = "all"
"""Argument of --type that shows every interpretation."""

Cells = list[int] | ModbusError

_PLACE = re.compile(r"(?P<first>-?[^-:]*)(?:-(?P<last>[0-9]+))?(?P<type>:.+)?", re.DOTALL)


@dataclass(frozen=True)
class Item:
    """
    Values of one table, or a point of a register map.

    Attributes:
        table: a name in `TABLE_WORDS`.
        address: the address of the first cell, from 0.
        count: the number of values.
        kind: the type of the values; None for cells without a type.
        layout: name, order, encoding and padding of the type, as `Read` takes them.
        file: the number of the file, for the table "file".
        point: the point of a map, which determines the other attributes; or None.
        word: the table as it was typed; empty for references and points.
        typed: the address or the reference as it was typed, without range and type.
        base: the number of the first cell of a table, 0 or 1.
        is_range: True if the words say how many cells there are.
    """

    table: str
    address: int
    count: int = 1
    kind: ValueType | None = None
    layout: tuple[Any, ...] = ()
    file: int = 0
    point: Point | None = None
    word: str = ""
    typed: str = ""
    base: int = 0
    is_range: bool = False

    @property
    def size(self) -> int:
        """The number of cells of one value."""
        return 1 if self.kind is None else self.kind.registers

    @property
    def cells(self) -> int:
        """The number of cells of all values."""
        return self.count * self.size

    def number(self, cell: int = 0) -> str:
        """Return the number of a cell of this item, counted as the first one was typed."""
        if self.word or not self.typed:
            return str(self.address + self.base + cell)
        return f"{self.typed[0]}{int(self.typed[1:]) + cell:0{len(self.typed) - 1}}"

    def label(self, cell: int = 0) -> str:
        """Return the name of a cell of this item as it would be typed, such as "hr 101"."""
        return f"{self.word} {self.number(cell)}".lstrip()

    @property
    def read(self) -> Read:
        """The item as a `Plan` takes it; only for the four tables."""
        if self.point is not None:
            return self.point.read
        return Read(self.table, self.address, self.count, *self.layout)  # type: ignore[arg-type]

    @property
    def hint(self) -> str:
        """A remark for errors if the address looks like a reference; or empty."""
        return _hint(self.word, self.table, self.typed) if self.word else ""


class Words:
    """
    The words on the command line, taken one after the other.

    Args:
        options: those of the command: `type`, `order`, `encoding`, `padding`, `map`, `columns`,
            `count_from_1`.
        words: the words that say what is read or written.
        have_values: True if values follow the items, to write.

    Attributes:
        map: the register map, or None.
        is_all: True if every interpretation is shown.

    Raises:
        ValueError: options that do not fit together, or a mistake in the map.
    """

    def __init__(
        self, options: argparse.Namespace, words: Sequence[str], *, have_values: bool = False
    ) -> None:
        self.map: RegisterMap | None = map_of(options)
        self.is_all: bool = options.type == ALL and not have_values
        self._words = deque(words)
        self._have_values = have_values
        self._base = 1 if options.count_from_1 else 0
        self._type: str | None = None if self.is_all else options.type
        self._given = {
            name: value for name in USUAL if (value := getattr(options, name)) is not None
        }
        for name in self._given:
            if self.is_all:
                raise ValueError(f"--type all shows every interpretation, and has no --{name}")
            if self._type is None and not any(re.match(r"[0-9][0-9-]*:", each) for each in words):
                raise ValueError(f"--{name} needs --type, or a type as in hr 100:float32")
        self._typed(self._type)  # refuses what is wrong without any item, too

    def __bool__(self) -> bool:
        return bool(self._words)

    def whole_map(self) -> list[Item]:
        """Return all points of the map that can be read."""
        points = self.map.values() if self.map is not None else ()
        return [_of_point(point) for point in points if point.is_readable]

    def group(self, name: str) -> list[Item]:
        """
        Return the points of a group of the map that can be read.

        Raises:
            ValueError: the map has no such group.
        """
        assert self.map is not None
        return [_of_point(self.map[each]) for each in self.map.group(name)]

    def sources_of(self, items: Iterable[Item]) -> list[Item]:
        """Return the points that scale the items, each before the points that it scales."""
        if self.map is None:
            return []
        from ...maps.point_plan import sources_of

        points = [item.point for item in items if item.point is not None]
        return [_of_point(point) for point in sources_of(points, self.map).values()]

    # --- places --------------------------------------------------------------------------

    def take_item(self) -> Item:
        """
        Take ``TABLE ADDRESS``, a reference, or a name.

        Raises:
            ValueError: the word is none of these.
        """
        first = self._pop()
        name = first.partition(":")[0]
        if name in TABLE_WORDS:
            return self._in_table(first, name)
        if self.map is not None and first in self.map:
            if self._type is not None or self.is_all:
                raise ValueError(f"{first} has the type that the map gives, and takes no --type")
            return _of_point(self.map[first])
        if word := _table_word(name):
            return self._in_table(first, word)
        if name.partition("-")[0].isdecimal():
            return self._referred(first)
        if self.map is not None:
            self.map.plan([first])  # raises an error with similar names
        raise ValueError(
            f"{first!r} must be one of {', '.join(TABLE_WORDS)}, a reference such as 40123,"
            f" or with --map FILE a name{close_word(first.lower(), TABLE_WORDS, VENDORS)}"
        )

    def take_count(self, item: Item) -> int:
        """Take the count of an item; 1 if the next word is not a count."""
        if item.is_range or not self._words or not re.match("[+-]?[0-9]", self._words[0]):
            return item.count
        if not item.word and re.match("[0-9]{5,6}(?![0-9])", self._words[0]):  # a reference
            return item.count
        return number_of("count", self._words.popleft())

    def take_values(self) -> list[str]:
        """Take all words up to the next item."""
        values = []
        while self._words and not self._begins_item(self._words[0]):
            values.append(self._words.popleft())
        return values

    def _pop(self) -> str:
        """Take a word; of a word such as 40101=5 only what stands before the value."""
        word = self._words.popleft()
        if "=" not in word or (self.map is not None and word in self.map):
            return word
        if not self._have_values:
            raise ValueError(f"{word!r} has a value, which the command write takes")
        word, _, value = word.partition("=")
        self._words.appendleft(value)
        return word

    def _begins_item(self, word: str) -> bool:
        name = word.partition(":")[0]
        if name in TABLE_WORDS or (self.map is not None and word in self.map):
            return True
        before, has_value, _ = word.partition("=")
        if has_value and self.map is not None and before in self.map:
            return True
        if has_value and re.fullmatch("[0-9]{5,6}(:.+)?", before):
            return True
        # Short words such as "di" may be texts to write; a table has an address behind it.
        has_address = len(self._words) > 1 and re.match("[0-9]", self._words[1])
        return bool(has_address and _table_word(name))

    def _in_table(self, first: str, name: str) -> Item:
        file = first.partition(":")[2]
        if (name == "file") != bool(file):
            raise ValueError(
                f"{first!r}: a file needs a number, as in file:4, and only a file has one"
            )
        if not self._words:
            raise ValueError(f"{first} lacks an address")
        typed, last, kind = _split(self._pop())
        table, number = TABLE_WORDS[name], number_of("file", file) if file else 0
        base = 0 if table == "file" else self._base
        try:
            address = _address(typed, base)
            end = address if last is None else _address(last, base)
        except ValueError as error:
            raise ValueError(f"{error}{_hint(name, table, typed)}") from None
        item = Item(table, address, file=number, word=first, typed=typed, base=base)
        return self._with_type(item, kind, end)

    def _referred(self, first: str) -> Item:
        typed, last, kind = _split(first)
        table, address = parse_reference(typed)
        if table == "file":
            raise ValueError(f"{typed!r} lacks the number of the file: type file:N {address}")
        end = parse_reference(last) if last is not None else (table, address)
        if end[0] != table:
            raise ValueError(f"{first!r}: both references must be of one table")
        return self._with_type(Item(table, address, typed=typed, base=self._base), kind, end[1])

    def _with_type(self, item: Item, name: str | None, last: int) -> Item:
        """Return an item with its type, or that of --type, up to the cell at an address."""
        wanted = name or self._type
        if (wanted is not None or self.is_all) and item.table not in REGISTERS:
            allowed = ", ".join(word for word, table in TABLE_WORDS.items() if table in REGISTERS)
            raise ValueError(f"{item.table.replace('_', ' ')} have no type, only {allowed} have")
        layout = self._typed(wanted)
        kind = (
            value_type(layout[0], **dict(zip(USUAL, layout[1:], strict=True))) if layout else None
        )
        item = replace(item, kind=kind, layout=layout, is_range=last != item.address)
        if not item.is_range:
            return item
        cells = last - item.address + 1
        if cells < 1 or cells % item.size:
            what = f"registers of {kind.name}, {item.size} each" if kind else "cells"
            raise ValueError(f"{item.label()} to {item.number(cells - 1)} is no range of {what}")
        return replace(item, count=cells // item.size)

    def _typed(self, name: str | None) -> tuple[Any, ...]:
        """Return name, order, encoding and padding of a type; empty without a type."""
        if name is None:
            return ()
        layout = {**USUAL, **self._given}
        value_type(name, **layout)
        return (name, *layout.values())


def _split(text: str) -> tuple[str, str | None, str | None]:
    """Return the address, the end of the range and the type of a word such as 100-105:float32."""
    found = _PLACE.fullmatch(text)
    if found is None:
        return text, None, None
    return found["first"], found["last"], found["type"] and found["type"][1:]


def _address(text: str, base: int) -> int:
    """Return an address from 0 of one that counts from a base."""
    shown = number_of("address", text)
    if not base <= shown < TABLE_SIZE + base:
        raise ValueError(f"address must be in {base}..{TABLE_SIZE - 1 + base}, not {shown}")
    return shown - base


def _of_point(point: Point) -> Item:
    return Item(point.table, point.address, point.count, point.read.kind, point=point)


def _table_word(text: str) -> str:
    """Return the word of `TABLE_WORDS` for a table as vendors write it; empty for none."""
    name = "fifo_queue" if plain(text) == "fifo queue" else table_named(text)
    return WORD_OF.get(name or "", text.lower() if text.lower() in TABLE_WORDS else "")


def map_of(options: argparse.Namespace) -> RegisterMap | None:
    """
    Load the register map of --map: a file, or an example by its name; None without the option.

    Raises:
        ValueError: the file cannot be read or contains a mistake, or the example does not exist.
    """
    if options.map is None:
        if options.columns:
            raise ValueError("--column needs --map")
        return None
    from ...tools.files.map_file import load_map
    from ...tools.simulator.example_files import map_file

    return load_map(map_file(options.map), columns=dict(options.columns))


def reason_of(error: ModbusError, item: Item) -> str:
    """Return why a request for an item failed, and what to try."""
    return f"{error}{item.hint if isinstance(error, IllegalDataAddress) else advice(error)}"


def _hint(word: str, table: str, typed: str) -> str:
    try:
        reference = parse_reference(typed)
    except ValueError:
        return ""
    if reference.table != table:
        return ""
    return (
        f" ({word} {typed} counts from 0; the reference {typed}, which is address"
        f" {reference.address}, is typed without {word})"
    )


# --- requests ------------------------------------------------------------------------


class ItemPlan:
    """
    The requests that read items, as `Plan` has them, and those of files and queues.

    Args:
        items: what is read.

    Attributes:
        plan: reads the items of the four tables.
        requests: those of the other items.

    Raises:
        ValueError: a count or address out of range.
    """

    def __init__(self, items: Sequence[Item]) -> None:
        self._count = len(items)
        self.plan: Plan = _CellPlan(
            {at: item.read for at, item in enumerate(items) if item.table not in OTHERS}
        )
        self._others = {
            at: OTHERS[item.table](item) for at, item in enumerate(items) if item.table in OTHERS
        }
        self.requests: list[pdu.Request[Any]] = [
            each for requests in self._others.values() for each in requests
        ]

    def cells(self, answers: Sequence[Any], others: Sequence[Any]) -> list[Cells]:
        """Return the cells of each item, or the error in place of them."""
        found: dict[int, Cells] = self.plan.results(answers)
        given = iter(others)
        for at, requests in self._others.items():
            found[at] = _joined([next(given) for _ in requests])
        return [found[at] for at in range(self._count)]


class _CellPlan(Plan):
    """A plan whose results are cells; a formatter decodes them."""

    def _decoded(self, name: Any, cells: list[Any]) -> Any:
        return [int(cell) for cell in cells]


def _joined(answers: list[Any]) -> Cells:
    cells: list[int] = []
    for answer in answers:
        if isinstance(answer, ModbusError):
            return answer
        cells += answer[0] if answer and isinstance(answer[0], list) else answer
    return cells


def _of_file(item: Item) -> list[pdu.Request[Any]]:
    """Return requests that divide no value, because its halves could be of different age."""
    most = REGISTERS["file"][0]
    if item.kind is not None and item.size > most:
        raise ValueError(f"{item.kind.name} takes {item.size} registers, and a request {most}")
    if item.count < 1:
        raise ValueError(f"count must be 1 or more, not {item.count}")
    step = max(USUAL_RECORDS // item.size, 1) * item.size if item.cells > most else item.cells
    stop = item.address + item.cells
    return [
        pdu.ReadFileRecords(((item.file, at, min(step, stop - at)),))
        for at in range(item.address, stop, step)
    ]


def _of_queue(item: Item) -> list[pdu.Request[Any]]:
    if item.count != 1:
        raise ValueError("fifo takes no count: a queue is always read as a whole")
    return [pdu.ReadFifoQueue(item.address)]


OTHERS = {"file": _of_file, "fifo_queue": _of_queue}
"""Item outside the four tables -> function that returns its requests."""
