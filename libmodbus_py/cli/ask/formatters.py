"""
Values that were read, as lines of text, cells of CSV and fields of JSON.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from ...protocol.plain import plain, text_of
from ...protocol.values import Interpretation, ValueType, readings, value_type
from ..failing import CommandError
from .items import REGISTERS, Item

if TYPE_CHECKING:
    from ...maps.meaning import Judged
    from ...maps.point import Point

__all__ = ["FormattedValue", "Formatter", "ReadResult", "aligned", "formatter_of", "in_line"]


NUMBER_CHARACTERS = 5
"""The width of an address, so that the addresses of several commands are below each other."""


class FormattedValue(NamedTuple):
    """
    One value as text.

    Attributes:
        where: the address or the name of the value.
        text: the value for people.
        plain: the value for CSV.
        unit: the physical unit, such as "V"; the reason in brackets if there is no value.
    """

    where: str
    text: str
    plain: str
    unit: str = ""


class Formatter:
    """
    Formats the cells of an item as they are: registers as numbers, bits as 0 and 1.

    Args:
        item: the item that is read.
        in_hex: format registers in hexadecimal.

    Attributes:
        item: as given.
        source: the value of the point that scales the item's point.
        shows_all: True if the rows are interpretations of one value.
    """

    shows_all: bool = False

    def __init__(self, item: Item, *, in_hex: bool = False) -> None:
        self.item = item
        self.source: Any = None
        self._in_hex = in_hex and item.table in (*REGISTERS, "fifo_queue")

    @property
    def is_text(self) -> bool:
        """True if values are text, which is aligned at the left."""
        return False

    def titles(self) -> list[str]:
        """Return the titles of the columns of CSV, one for each value."""
        if self.item.table == "fifo_queue":
            raise ValueError("fifo cannot be used with --csv: its number of columns is unknown")
        return [self.item.label(at) for at in self._cells(self.item.count)]

    def rows(self, cells: list[int]) -> list[FormattedValue]:
        """Return each value as text."""
        form = "0x{:04X}" if self._in_hex else "{}"
        texts = [form.format(cell) for cell in cells]
        pairs = zip(self._cells(len(texts)), texts, strict=True)
        return [FormattedValue(self.item.number(at), text, text) for at, text in pairs]

    def fields(self, cells: list[int]) -> dict[str, Any]:
        """Return the fields of JSON."""
        return {**self.whence, "values": cells}

    def remark(self, cells: list[int]) -> str:
        """Return why there is no value, for CSV; empty if there is one."""
        return ""

    @property
    def whence(self) -> dict[str, Any]:
        """The fields of JSON that name the item."""
        item = self.item
        found: dict[str, Any] = {"table": item.table, "address": item.address + item.base}
        return {**found, "file": item.file} if item.table == "file" else found

    def _cells(self, count: int) -> range:
        """Return the first cell of each value."""
        return range(0, count * self.item.size, self.item.size)


class _TypedFormatter(Formatter):
    """Formats values of a type; each has the address of its first register."""

    def __init__(self, item: Item, kind: ValueType) -> None:
        super().__init__(item)
        self._kind = kind

    @property
    def is_text(self) -> bool:
        return self._kind.is_text

    def rows(self, cells: list[int]) -> list[FormattedValue]:
        values = self._values(cells)
        pairs = zip(self._cells(len(values)), values, strict=True)
        return [
            FormattedValue(self.item.number(at), *_texts(each, self._kind)) for at, each in pairs
        ]

    def fields(self, cells: list[int]) -> dict[str, Any]:
        values = self._values(cells)
        kind = {"type": self._kind.name, "order": self._kind.order}
        told = {"values": [_as_json(value) for value in values]}
        # Which JSON has no numbers for: the values are null, and their texts stand here.
        first = self.item.address + self.item.base
        texts = {
            str(first + at): str(value)
            for at, value in zip(self._cells(len(values)), values, strict=True)
            if isinstance(value, float) and not math.isfinite(value)
        }
        return {**self.whence, **kind, **told, **({"no_value": texts} if texts else {})}

    def _values(self, cells: list[int]) -> list[Any]:
        try:
            return self._kind.decode_many(cells)
        except ValueError as error:
            place = f"{self.item.table.replace('_', ' ')} from {self.item.number()}"
            raise CommandError(f"{place}: {error}") from None


class _AllFormatter(Formatter):
    """Formats registers as one value, in every way that makes sense."""

    shows_all = True

    def __init__(self, item: Item) -> None:
        super().__init__(item)
        if item.table not in REGISTERS:
            raise ValueError(f"{item.label()} takes no --type")
        limit = REGISTERS[item.table][0]
        if not 1 <= item.count <= limit:
            raise ValueError(f"count must be in 1..{limit}, not {item.count}")

    @property
    def is_text(self) -> bool:
        return True

    def titles(self) -> list[str]:
        raise ValueError("--type all cannot be used with --csv")

    def rows(self, cells: list[int]) -> list[FormattedValue]:
        found = self._readings(cells)
        width = max(len(reading.type) for reading in found)
        return [
            FormattedValue(f"{name:<{width}}  {order}", *_texts(value, value_type(name)))
            for name, order, value in found
        ]

    def fields(self, cells: list[int]) -> dict[str, Any]:
        found = self._readings(cells)
        rows = [{**reading._asdict(), "value": _as_json(reading.value)} for reading in found]
        return {**self.whence, "registers": cells, "readings": rows}

    def _readings(self, cells: list[int]) -> list[Interpretation]:
        found = readings(cells)
        if not found:
            raise CommandError(f"{len(cells)} registers can only be text, and these are not")
        return found


class _PointFormatter(Formatter):
    """Formats a point of a register map."""

    def __init__(self, item: Item, point: Point) -> None:
        super().__init__(item)
        self._point = point

    @property
    def is_text(self) -> bool:
        is_named = self._point.states is not None or self._point.bits is not None
        kind = self.item.kind
        return is_named or (kind is not None and (kind.is_text or kind.is_time))

    def titles(self) -> list[str]:
        """Return the names, with the units of measurement."""
        units = f" ({self._point.units})" if self._point.units else ""
        return [f"{name}{units}" for name in self._names()]

    def _names(self) -> list[str]:
        point = self._point
        return [point.name] if point.count == 1 else [f"{point.name}[{at}]" for at in self._range]

    def rows(self, cells: list[int]) -> list[FormattedValue]:
        found, point = self.judged(cells), self._point
        values = [found.value] if point.count == 1 else found.value
        return [
            FormattedValue(title, "-", "", f"({found.reason})")
            if each is None
            else FormattedValue(title, *self._texts(each), point.units)
            for title, each in zip(self._names(), values, strict=True)
        ]

    def fields(self, cells: list[int]) -> dict[str, Any]:
        found = self.judged(cells)
        value = found.value
        shown_value = [_as_json(each) for each in value] if self._point.count > 1 else value
        fields = {**self.whence, "value": _as_json(shown_value)}
        if not found.reason:
            return fields
        return {**fields, "no_value": {"quality": found.quality, "reason": found.reason}}

    def remark(self, cells: list[int]) -> str:
        reason = self.judged(cells).reason
        return f"{self._point.name}: {reason}" if reason else ""

    @property
    def whence(self) -> dict[str, Any]:
        return {"name": self._point.name}

    @property
    def _range(self) -> range:
        return range(self._point.count)

    def judged(self, cells: list[int]) -> Judged:
        bits = [bool(cell) for cell in cells] if self.item.kind is None else cells
        try:
            return self._point.judge(bits, source=self.source)
        except ValueError as error:
            raise CommandError(str(error)) from None

    def _texts(self, value: Any) -> tuple[str, str]:
        kind, point = self.item.kind, self._point
        is_as_read = (point.scale, point.offset, point.scale_from) == (1, 0, None)
        is_named = isinstance(value, str) and point.states is not None
        if isinstance(value, dict):
            text = " ".join(f"{name}={int(each)}" for name, each in value.items())
        elif kind is not None and is_as_read and not is_named and not point.is_part:
            return _texts(value, kind)
        else:
            text = str(int(value) if isinstance(value, bool) else value)
        return text, text


class ReadResult(NamedTuple):
    """
    The result of one item.

    Attributes:
        formatter: formats the values of the item.
        rows: the values; empty after a failure.
        fields: the fields of JSON.
        failure: the reason of a failure; empty without one.
        remark: why a point has no value; empty without one.
        has_fallen: True for a total that is smaller than before.
    """

    formatter: Formatter
    rows: list[FormattedValue]
    fields: dict[str, Any]
    failure: str = ""
    remark: str = ""
    has_fallen: bool = False


def formatter_of(item: Item, *, as_all: bool, in_hex: bool) -> Formatter:
    """
    Return the formatter of an item.

    Args:
        as_all: format every interpretation of the registers.
        in_hex: format registers without a type in hexadecimal.

    Raises:
        ValueError: the item cannot be formatted so.
    """
    if item.point is not None:
        return _PointFormatter(item, item.point)
    if as_all:
        return _AllFormatter(item)
    return Formatter(item, in_hex=in_hex) if item.kind is None else _TypedFormatter(item, item.kind)


def aligned(groups: Sequence[tuple[Formatter, list[FormattedValue]]]) -> list[str]:
    """Return a line for each value, which begins with the table if there are several items."""
    several = len(groups) > 1
    placed = [each for each in groups if each[0].item.word]  # neither references nor names
    word = max((len(each.item.word) for each, _ in placed), default=0) if several else 0
    width = max((len(row.where) for _, rows in placed for row in rows), default=0)
    width = width if several else NUMBER_CHARACTERS
    wheres = [[_where(each, row, word, width) for row in rows] for each, rows in groups]
    label = max((len(where) for group in wheres for where in group), default=0)
    numbers = max(
        (len(row.text) for formatter, rows in groups if not formatter.is_text for row in rows),
        default=0,
    )
    return [
        f"{where:<{label}}  {row.text:>{0 if formatter.is_text else numbers}} {row.unit}".rstrip()
        for (formatter, rows), group in zip(groups, wheres, strict=True)
        for where, row in zip(group, rows, strict=True)
    ]


def _where(formatter: Formatter, row: FormattedValue, word: int, width: int) -> str:
    """Return what a line begins with: a name, or a table and a number below those of others."""
    item = formatter.item
    if item.point is not None or formatter.shows_all or (word and not item.word):
        return row.where
    return f"{item.word:<{word}} {row.where:>{width}}" if word else f"{row.where:>{width}}"


def in_line(result: ReadResult, *, several: bool) -> str:
    """Return the values of an item in one line; several items are named."""
    item = result.formatter.item
    values = " ".join(f"{row.text} {row.unit}".rstrip() for row in result.rows)
    values = values or f"({result.failure})"
    values += " (fell)" * result.has_fallen
    if item.point is not None:
        return f"{item.point.name}={values}"
    return f"{item.label()}: {values}" if several else values


def _texts(value: Any, kind: ValueType) -> tuple[str, str]:
    text = text_of(value, kind)
    return text, value if isinstance(value, str) else text


def _as_json(value: Any) -> Any:
    """Return a value for JSON, as outputs of fleets have it: bits are true and false."""
    return plain(value)
