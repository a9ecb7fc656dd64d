"""
The words that say what is read or written: tables and addresses, references, names.
"""

from __future__ import annotations

import argparse
import re
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ...maps.plan import Read
from ...protocol.spelling import number_of
from ...protocol.tables import TABLE_SIZE, TABLES
from ...protocol.values import ValueType, parse_reference, value_type
from ...protocol.words import TABLE_WORDS as VENDORS
from ...protocol.words import close_word, plain, table_named

if TYPE_CHECKING:
    from ...maps.point import Point
    from ...maps.register_map import RegisterMap

__all__ = ["ALL", "REGISTERS", "TABLE_WORDS", "Item", "Words", "map_of"]

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

USUAL = {"order": "ABCD", "encoding": "ascii", "padding": "\0"}
"""Options of a type -> their defaults."""

ALL = "all"
"""Argument of --type that shows every interpretation."""


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
        first: the address that is printed for the first cell.
        typed: the word with the address, for hints.
    """

    table: str
    address: int
    count: int = 1
    kind: ValueType | None = None
    layout: tuple[Any, ...] = ()
    file: int = 0
    point: Point | None = None
    first: int = 0
    typed: str = ""

    @property
    def size(self) -> int:
        """The number of cells of one value."""
        return 1 if self.kind is None else self.kind.registers

    @property
    def cells(self) -> int:
        """The number of cells of all values."""
        return self.count * self.size

    @property
    def word(self) -> str:
        """The table as a word of the command line."""
        return f"file:{self.file}" if self.table == "file" else WORD_OF[self.table]

    @property
    def read(self) -> Read:
        """The item as a `Plan` takes it; only for the four tables."""
        if self.point is not None:
            return self.point.read
        return Read(self.table, self.address, self.count, *self.layout)  # type: ignore[arg-type]

    @property
    def hint(self) -> str:
        """A remark for errors if the address looks like a reference; or empty."""
        return _hint(self.word, self.table, self.typed)


class Words:
    """
    The words on the command line, taken one after the other.

    Args:
        options: those of the command: `type`, `order`, `encoding`, `padding`, `map`,
            `count_from_1`.
        words: the words that say what is read or written.

    Attributes:
        map: the register map, or None.

    Raises:
        ValueError: options that do not fit together, or a mistake in the map.
    """

    def __init__(self, options: argparse.Namespace, words: list[str]) -> None:
        self.map: RegisterMap | None = map_of(options.map) if options.map is not None else None
        self._words = deque(words)
        self._base = 1 if options.count_from_1 else 0
        self._has_type = options.type is not None
        self._layout = _layout(options)
        self._kind = value_type(self._layout[0], **_named(self._layout)) if self._layout else None

    def __bool__(self) -> bool:
        return bool(self._words)

    def whole_map(self) -> list[Item]:
        """Return all points of the map that can be read."""
        points = self.map.values() if self.map is not None else ()
        return [self._of_point(point) for point in points if point.is_readable]

    def group(self, name: str) -> list[Item]:
        """
        Return the points of a group of the map that can be read.

        Raises:
            ValueError: the map has no such group.
        """
        assert self.map is not None
        return [self._of_point(self.map[each]) for each in self.map.group(name)]

    def sources_of(self, items: Iterable[Item]) -> list[Item]:
        """Return the points that scale the items, each before the points that it scales."""
        if self.map is None:
            return []
        from ...maps.point_plan import sources_of

        points = [item.point for item in items if item.point is not None]
        found = sources_of(points, self.map)
        return [self._of_point(point) for point in found.values()]

    # --- places --------------------------------------------------------------------------

    def take_item(self) -> Item:
        """
        Take ``TABLE ADDRESS``, a reference, or a name.

        Raises:
            ValueError: the word is none of these.
        """
        first = self._words.popleft()
        if (name := first.partition(":")[0]) in TABLE_WORDS:
            return self._in_table(first, name)
        if self.map is not None and first in self.map:
            return self._named(first, self.map)
        if word := _table_word(name):
            return self._in_table(first, word)
        if first.isdecimal():
            return self._referred(first)
        if self.map is not None:
            self.map.plan([first])  # raises an error with similar names
        raise ValueError(
            f"{first!r} must be one of {', '.join(TABLE_WORDS)}, a reference such as 40123,"
            f" or with --map FILE a name{close_word(first.lower(), TABLE_WORDS, VENDORS)}"
        )

    def take_count(self, item: Item) -> int:
        """Take the count of an item; 1 if the next word is not a count."""
        if self._words and re.match("[+-]?[0-9]", self._words[0]) and not self._has_next(item):
            return number_of("count", self._words.popleft())
        return 1

    def take_values(self) -> list[str]:
        """Take all words up to the next table or name."""
        values = []
        while self._words and not self._begins_item(self._words[0]):
            values.append(self._words.popleft())
        return values

    def _begins_item(self, word: str) -> bool:
        name = word.partition(":")[0]
        if name in TABLE_WORDS or (self.map is not None and word in self.map):
            return True
        # Short words such as "di" may be texts to write; a table has an address behind it.
        has_address = len(self._words) > 1 and re.match("[0-9]", self._words[1])
        return bool(has_address and _table_word(name))

    def _has_next(self, item: Item) -> bool:
        """Return True if the next word is a reference, and not the count of a reference."""
        word = self._words[0]
        return not item.typed and word.isdecimal() and len(word) in (5, 6)

    def _in_table(self, first: str, name: str) -> Item:
        file = first.partition(":")[2]
        if (name == "file") != bool(file):
            raise ValueError(
                f"{first!r}: a file needs a number, as in file:4, and only a file has one"
            )
        if not self._words:
            raise ValueError(f"{first} lacks an address")
        typed = self._words.popleft()
        table, number = TABLE_WORDS[name], number_of("file", file) if file else 0
        base = 0 if table == "file" else self._base
        try:
            shown = number_of("address", typed)
            if not base <= shown < TABLE_SIZE + base:
                span = f"{base}..{TABLE_SIZE - 1 + base}"
                raise ValueError(f"address must be in {span}, not {shown}")
        except ValueError as error:
            raise ValueError(f"{error}{_hint(name, table, typed)}") from None
        return self._item(table, shown - base, shown, file=number, typed=typed)

    def _referred(self, first: str) -> Item:
        table, address = parse_reference(first)
        if table == "file":
            raise ValueError(f"{first!r} lacks the number of the file: type file:N {address}")
        return self._item(table, address, address + self._base)

    def _named(self, name: str, points: RegisterMap) -> Item:
        if self._has_type:
            raise ValueError(f"{name} has the type that the map gives, and takes no --type")
        return self._of_point(points[name])

    def _of_point(self, point: Point) -> Item:
        return Item(point.table, point.address, point.count, point.read.kind, point=point)

    def _item(self, table: str, address: int, first: int, **others: Any) -> Item:
        if self._has_type and table not in REGISTERS:
            allowed = ", ".join(word for word, name in TABLE_WORDS.items() if name in REGISTERS)
            raise ValueError(f"{table.replace('_', ' ')} have no --type, only {allowed} have")
        layout = self._layout
        return Item(table, address, kind=self._kind, layout=layout, first=first, **others)


def _table_word(text: str) -> str:
    """Return the word of `TABLE_WORDS` for a table as vendors write it; empty for none."""
    name = "fifo_queue" if plain(text) == "fifo queue" else table_named(text)
    return WORD_OF.get(name or "", text.lower() if text.lower() in TABLE_WORDS else "")


def map_of(file: str) -> RegisterMap:
    """
    Load a register map from a file, or an example by its name, which has no suffix.

    Raises:
        ValueError: the file cannot be read or contains a mistake, or the example does not exist.
    """
    from ...tools.files.maps.map_file import load_map
    from ...tools.simulator.example_files import map_file

    return load_map(map_file(file))


def _layout(options: argparse.Namespace) -> tuple[Any, ...]:
    """Return name, order, encoding and padding of the type; empty without --type."""
    given = {name: getattr(options, name) for name in USUAL}
    told = [name for name, value in given.items() if value is not None]
    if options.type is None:
        for name in told:
            raise ValueError(f"--{name} needs --type")
        return ()
    if options.type == ALL and options.can_show_all:
        for name in told:
            raise ValueError(f"--type all shows every interpretation, and has no --{name}")
        return ()
    return (options.type, *(given[name] or usual for name, usual in USUAL.items()))


def _named(layout: tuple[Any, ...]) -> dict[str, Any]:
    return dict(zip(USUAL, layout[1:], strict=True))


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
