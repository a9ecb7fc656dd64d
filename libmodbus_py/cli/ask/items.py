"""
Items that are read or written: tables and addresses, references, names; taken from words.

::

    hr 100    40101    voltage      a cell of a table, a reference, a point of a map
    hr 100:float32:CDAB             a type and an order for this item, in place of --type, --order
    hr 100-105    40101-40106       a range of cells
    hr 100.3      40101.3           a bit of a register, 0 the lowest
    40101=5    hr 100=5             a value behind it, for a write
"""

from __future__ import annotations

import argparse
import re
from collections import deque
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from ...protocol import pdu
from ...protocol.checks import integer
from ...protocol.errors import IllegalDataAddress, ModbusError
from ...protocol.plain import number_of
from ...protocol.tables import REGISTER_TABLES, TABLE_SIZE, TABLES, checked_values
from ...protocol.words import (
    REFERENCE_TABLES,
    close_word,
    parse_reference,
    plain,
    table_named,
    type_named,
)
from ...protocol.words import TABLE_WORDS as VENDORS
from ..arguments import list_keys
from ..main import advice

if TYPE_CHECKING:
    from ...maps.items import Borders, Read
    from ...maps.point import Point
    from ...maps.register_map import RegisterMap
    from ...protocol.values import ValueType

TABLE_WORDS = {
    "coils": "coils",
    "discrete": "discrete_inputs",
    "holding": "holding_registers",
    "input": "input_registers",
    "file": "file",
    "fifo": "fifo_queue",
}
"""Word on the command line -> name of the table; `protocol.words` has more for the first four."""

REGISTERS = (*REGISTER_TABLES, "file")
"""Tables whose values can have a type."""

USUAL = {"order": "ABCD", "encoding": "ascii", "padding": "\0"}
"""Options of a type -> their defaults."""

ALL, HEX = "all", "hex"
"""Forms of registers without a type: every interpretation (--type all), and hexadecimal."""

RECORDS = 121
"""Records of a file that one request reads: the byte count of the answer goes to 245."""

_PLACE = re.compile(
    r"(?P<first>-?[^-:.]*)(?:\.(?P<bit>[0-9]+)|(?:-(?P<last>[0-9]+))?(?P<type>:.+)?)", re.DOTALL
)


class Item(NamedTuple):
    """
    Values of one table, or a point of a register map.

    Attributes:
        file: the number of the file, for the table "file".
        word, typed: the table and the first address, as typed; a reference has no word.
        base: the number of the first cell of a table, 0 or 1.
        is_range: True if the words say how many cells there are.
        form: `ALL`, `HEX`, or empty.
        bit: the bit of the register that is the value; None for the whole.
    """

    table: str
    address: int
    count: int = 1  # type: ignore[assignment]  # in place of the method of tuples
    kind: ValueType | None = None
    file: int = 0
    point: Point | None = None
    word: str = ""
    typed: str = ""
    base: int = 0
    is_range: bool = False
    form: str = ""
    bit: int | None = None

    @property
    def size(self) -> int:
        """The number of cells of one value."""
        return 1 if self.kind is None else self.kind.registers

    def number(self, cell: int = 0) -> str:
        """Return the number of a cell of this item, counted as the first one was typed."""
        bit = "" if self.bit is None else f".{self.bit}"
        if self.word or not self.typed:
            return f"{self.address + self.base + cell}{bit}"
        return f"{self.typed[0]}{int(self.typed[1:]) + cell:0{len(self.typed) - 1}}{bit}"

    def label(self, cell: int = 0) -> str:
        """Return the name of a cell of this item as it would be typed, such as "hr 101"."""
        return f"{self.word} {self.number(cell)}".lstrip()

    @property
    def read(self) -> Read:
        """The item as a `Plan` of cells takes it; only for the four tables."""
        if self.point is not None:
            return self.point.read
        from ...maps.items import Read

        name = None if self.kind is None else self.kind.name  # by which no request divides a value
        return Read(self.table, self.address, self.count, name)  # type: ignore[arg-type]


class Words:
    """The words on the command line, read one after the other; items to write have values."""

    def __init__(
        self, options: argparse.Namespace, words: Sequence[str], *, have_values: bool = False
    ) -> None:
        self.map: RegisterMap | None = map_of(options)
        is_all = options.type == ALL and not have_values
        self._form = HEX if getattr(options, "hex", False) else ""
        if is_all:
            self._form = ALL
        self._words = deque(words)
        self._have_values = have_values
        self._base = int(options.count_from_1)
        self._type: str | None = None if is_all else options.type
        layout = {name: value for name in USUAL if (value := getattr(options, name)) is not None}
        for name in layout:
            if is_all:
                raise ValueError(f"--type all shows every interpretation, and has no --{name}")
            if self._type is None and not any(re.match(r"[0-9][0-9-]*:", word) for word in words):
                raise ValueError(f"--{name} needs --type, or a type as in hr 100:float32")
        self._options_of_types = {**USUAL, **layout}
        self._kind(self._type)  # refuses invalid options without any item, too

    def __bool__(self) -> bool:
        return bool(self._words)

    def all_items(self, groups: Iterable[str]) -> list[Item]:
        """Return all items of a read: groups of the map, and typed items; else the whole map."""
        names: list[str] = []
        for group in groups:
            if self.map is None:
                raise ValueError("--group needs --map FILE, which has the groups")
            names += self.map.group(group)
        if not names and not self._words:
            if self.map is None:
                raise ValueError("WHAT is missing: name a table and an address, or --map FILE")
            names = [point.name for point in self.map.values() if point.is_readable]
        items = [_of_point(self.map[name]) for name in names] if self.map is not None else []
        while self._words:
            item = self.take_item()
            items.append(item if item.point else item._replace(count=self._take_count(item)))
        return items

    def borders(self) -> Borders:
        """Return the borders of the map, which no request may cross."""
        if self.map is None:
            return ()
        from ...maps.point_plan import borders_of

        return borders_of(self.map.values())

    def sources_of(self, items: Iterable[Item]) -> list[Item]:
        """Return the points that scale the items, each before the points that it scales."""
        if self.map is None:
            return []
        from ...maps.point_plan import sources_of

        points = [item.point for item in items if item.point is not None]
        return [_of_point(point) for point in sources_of(points, self.map).values()]

    def take_item(self) -> Item:
        """Read ``TABLE ADDRESS``, a reference, or a name; raise ValueError for other words."""
        first = self._pop()
        name = first.partition(":")[0]
        if name in TABLE_WORDS or (_table_word(name) and not self._is_point(first)):
            return self._in_table(first, _table_word(name))
        if self.map is not None and first in self.map:
            if self._type is not None or self._form == ALL:
                raise ValueError(f"{first} has the type that the map gives, and takes no --type")
            return _of_point(self.map[first])
        if re.match("[0-9]+[-.]|[0-9]+$", name):
            return self._referred(first)
        if self.map is not None:
            self.map.plan([first])  # raises an error with similar names
        close = close_word(first.lower(), TABLE_WORDS, VENDORS)
        if first.endswith((".csv", ".toml")):
            close = f"; type --map {first}"
        elif type_named(first):
            close = f"; type --type {first}, or the type behind the address, as in hr 0:{first}"
        raise ValueError(
            f"{first!r} must be one of {', '.join(TABLE_WORDS)}, a reference such as 40123,"
            f" or with --map FILE a name{close}"
        )

    def take_values(self) -> list[str]:
        """Read all words up to the next item."""
        values = []
        while self._words and not self._begins_item(self._words[0]):
            values.append(self._words.popleft())
        return values

    def _take_count(self, item: Item) -> int:
        """Take the count of an item; 1 if the next word is not a count."""
        if item.is_range or not self._words or not re.match("[+-]?[0-9]", self._words[0]):
            return item.count
        reference = "[0-9]{5,6}[.:]" if item.word else "[0-9]{5,6}(?![0-9])"
        if re.match(reference, self._words[0]):
            return item.count
        if item.bit is not None:
            raise ValueError(f"{item.label()} is one bit, and takes no count")
        return number_of("count", self._words.popleft())

    def _pop(self) -> str:
        """Take a word; of a word such as 40101=5 only the part before the value."""
        word = self._words.popleft()
        if "=" not in word or self._is_point(word):
            return word
        if not self._have_values:
            raise ValueError(f"{word!r} has a value, which the command write takes")
        word, _, value = word.partition("=")
        self._words.appendleft(value)
        return word

    def _begins_item(self, word: str) -> bool:
        name = word.partition(":")[0]
        before, has_value, _ = word.partition("=")
        if name in TABLE_WORDS or self._is_point(word):
            return True
        if has_value and (self._is_point(before) or re.fullmatch("[0-9]{5,6}([.:].+)?", before)):
            return True
        # Short words such as "di" may be texts to write; a table has an address behind it.
        has_address = len(self._words) > 1 and re.match("[0-9]", self._words[1])
        return bool(has_address and _table_word(name))

    def _is_point(self, name: str) -> bool:
        return self.map is not None and name in self.map

    def _in_table(self, first: str, name: str) -> Item:
        file = first.partition(":")[2]
        if (name == "file") != bool(file):
            raise ValueError(
                f"{first!r}: a file needs a number, as in file:4, and only a file has one"
            )
        if not self._words:
            raise ValueError(f"{first} lacks an address")
        digits, bit, last, kind = _split(self._pop())
        number = number_of("file", file) if file else 0
        base = 0 if name == "file" else self._base
        try:
            address = _address(digits, base)
        except ValueError as error:
            raise ValueError(f"{error}{_meant(first, digits, TABLE_WORDS[name])}") from None
        end = address if last is None else _address(last, base)
        item = Item(TABLE_WORDS[name], address, file=number, word=first, typed=digits, base=base)
        return self._with_type(item, kind, end) if bit is None else _with_bit(item, bit)

    def _referred(self, first: str) -> Item:
        number, bit, last, kind = _split(first)
        table, address = parse_reference(number)
        if table == "file":
            raise ValueError(f"{number!r} lacks the number of the file: type file:N {address}")
        end = parse_reference(last) if last is not None else (table, address)
        if end[0] != table:
            raise ValueError(f"{first!r}: both references must be of one table")
        item = Item(table, address, typed=number, base=self._base)
        return self._with_type(item, kind, end[1]) if bit is None else _with_bit(item, bit)

    def _with_type(self, item: Item, name: str | None, last: int) -> Item:
        """Return an item with its type, or that of --type, up to the cell at an address."""
        type_name = name or self._type
        form = "" if name else self._form
        if (type_name is not None or form == ALL) and item.table not in REGISTERS:
            names = ", ".join(word for word, table in TABLE_WORDS.items() if table in REGISTERS)
            raise ValueError(f"{item.table.replace('_', ' ')} have no type, only {names} have")
        kind = self._kind(type_name)
        is_range = last != item.address
        item = item._replace(kind=kind, form=form, is_range=is_range)
        if not is_range:
            return item
        cells = last - item.address + 1
        if cells < 1 or cells % item.size:
            what = f"registers of {kind.name}, {item.size} each" if kind else "cells"
            raise ValueError(f"{item.label()} to {item.number(cells - 1)} is no range of {what}")
        return item._replace(count=cells // item.size)

    def _kind(self, name: str | None) -> ValueType | None:
        if name is None:
            return None
        from ...protocol.values import value_type

        kind, _, order = name.rpartition(":")
        if not kind or order.isdecimal():  # string:8
            return value_type(name, **self._options_of_types)
        return value_type(kind, **{**self._options_of_types, "order": order})


def _split(text: str) -> tuple[str, str | None, str | None, str | None]:
    """
    Return the address, the bit, the end of the range and the type of a word such as 100.3 or
    100-105:float32.
    """
    match = _PLACE.fullmatch(text)
    if match is None:
        return text, None, None, None
    return match["first"], match["bit"], match["last"], match["type"] and match["type"][1:]


def _with_bit(item: Item, text: str) -> Item:
    if item.table not in REGISTER_TABLES:
        raise ValueError(f"{item.label()}.{text}: only holding and input registers have bits")
    return item._replace(bit=integer("bit", number_of("bit", text), 0, 15))


def _address(text: str, base: int) -> int:
    """Return an address from 0 of one that counts from a base."""
    number = number_of("address", text)
    if not base <= number < TABLE_SIZE + base:
        raise ValueError(f"address must be in {base}..{TABLE_SIZE - 1 + base}, not {number}")
    return number - base


def _of_point(point: Point) -> Item:
    return Item(point.table, point.address, point.count, point.read.kind, point=point)


def _table_word(text: str) -> str:
    """Return the word of `TABLE_WORDS` for a table as vendors write it; empty for none."""
    if text.lower() in TABLE_WORDS:
        return text.lower()
    table = "fifo_queue" if plain(text) == "fifo queue" else table_named(text)
    return next((word for word, name in TABLE_WORDS.items() if name == table), "")


def map_of(options: argparse.Namespace) -> RegisterMap | None:
    """Load the register map of --map: a file, or an example by its name; None without it."""
    if options.map is None:
        if list_keys(options):
            raise ValueError("--column, --from and --list need --map")
        return None
    from ...maps.register_map import load_map
    from ...tools.simulator.example_files import map_file

    return load_map(map_file(options.map), **list_keys(options))


# --- requests ------------------------------------------------------------------------


def requests_of(item: Item, max_registers: int) -> list[pdu.Request[Any]]:
    """Return the requests for an item, none of which divides a value; of a queue there is one."""
    if item.table == "fifo_queue":
        if item.count != 1:
            raise ValueError("fifo takes no count: a queue is always read as a whole")
        return [pdu.ReadFifoQueue(item.address)]
    end = item.address + item.count * item.size
    if item.table == "file":
        step = max(RECORDS // item.size, 1) * item.size
        firsts = range(item.address, max(end, item.address + 1), step)
        return [pdu.ReadFileRecords(((item.file, at, min(step, end - at)),)) for at in firsts]
    checked_values(item.address, item.count, item.size)
    rules = TABLES[item.table]
    step = rules.most_read if rules.is_bits else max_registers // item.size * item.size
    if item.kind is not None and not step:
        raise ValueError(
            f"{item.kind.name} takes {item.size} registers, which is more than max_registers,"
            f" {max_registers}"
        )
    return [rules.read(at, min(step, end - at)) for at in range(item.address, end, step)]


def cells_of(item: Item, answers: Sequence[Any]) -> Any:
    """Return the cells of an item in the answers to its requests, or the first error of them."""
    cells: list[int] = []
    for answer in answers:
        if isinstance(answer, ModbusError):
            return answer
        (part,) = answer if item.table == "file" else (answer,)
        cells += map(int, part)
    return cells


def reason_of(error: ModbusError, item: Item) -> str:
    """Return why a request for an item failed, and what to try."""
    if not isinstance(error, IllegalDataAddress):
        return f"{error}{advice(error)}"
    return f"{error}{_meant(item.word, item.typed, item.table)}"


def _meant(word: str, text: str, table: str) -> str:
    """Return a remark for errors if an address behind a table looks like a reference."""
    is_reference = text[1:].isdecimal() and len(text) > 4
    if not (word and is_reference and REFERENCE_TABLES.get(text[0]) == table):
        return ""
    return f" ({word} {text} counts from 0; the reference {text} is typed without {word})"
