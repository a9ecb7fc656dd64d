"""
Values that were read, as lines of text, cells of CSV and fields of JSON; and what prints them.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO

from ...protocol.errors import ModbusError
from ...protocol.plain import SHORT_FLOATS, clock_text, plain, shortest, text_of, time_text
from ..output import RedrawnLines, print_csv, print_json
from .items import ALL, HEX, REGISTERS, Item, reason_of
from .units import fail

if TYPE_CHECKING:
    from ...maps.point import Point
    from ...protocol.values import Interpretation, ValueType

CHANGED = "*"
"""Mark of a line whose value has just changed."""

NUMBER_CHARACTERS = 5
"""The width of an address, so that the addresses of several commands are below each other."""

MOST_AT_ONCE, SIZES, LIKELY = 125, (1, 2, 4), 3
"""Of --type all: the most registers of one value; those of a part of them; values of a part."""


class ValueText(NamedTuple):
    """
    One value as text for people, and for CSV (`plain`), behind its address or name.

    Attributes:
        unit: the physical unit, such as "V"; the reason in brackets if there is no value.
    """

    where: str
    text: str
    plain: str
    unit: str = ""


_Shown = tuple[list[ValueText], dict[str, Any]]
"""Values as text, and as fields of JSON."""


class ReadResult(NamedTuple):
    """
    The result of one item: rows, or the reason of a failure, and the fields of JSON.

    Attributes:
        remark: why a point has no value; empty without one.
        has_fallen: True for a total that is smaller than before.
    """

    item: Item
    rows: list[ValueText]
    fields: dict[str, Any]
    failure: str = ""
    remark: str = ""
    has_fallen: bool = False


def result_of(item: Item, cells: list[int] | ModbusError, source: Any = None) -> ReadResult:
    """Return the result of the cells of an item; `source` is the value that scales its point."""
    whence = _whence(item)
    if isinstance(cells, ModbusError):
        return ReadResult(item, [], {**whence, "error": str(cells)}, reason_of(cells, item))
    try:
        if item.point is not None:
            return _of_point(item, item.point, cells, source)
        if item.form == ALL:
            rows, fields = _in_all_ways(item, cells)
        elif item.kind is not None:
            rows, fields = _of_type(item, item.kind, cells)
        elif item.bit is not None:
            bit = cells[0] >> item.bit & 1
            rows, fields = [ValueText(item.number(), str(bit), str(bit))], {"value": bool(bit)}
        else:
            is_hex = item.form == HEX and item.table in (*REGISTERS, "fifo_queue")
            form = "0x{:04X}" if is_hex else "{}"
            texts = [form.format(cell) for cell in cells]
            rows = [ValueText(item.number(at), text, text) for at, text in enumerate(texts)]
            fields = {"values": cells}
    except ValueError as error:
        return ReadResult(item, [], {**whence, "error": str(error)}, str(error))
    return ReadResult(item, rows, {**whence, **fields})


def _titles(item: Item) -> list[str]:
    """Return the titles of the columns of CSV, one for each value, with units of measurement."""
    if item.table == "fifo_queue":
        raise ValueError("fifo cannot be used with --csv: its number of columns is unknown")
    if item.form == ALL:
        raise ValueError("--type all cannot be used with --csv")
    if item.point is None:
        return [item.label(at * item.size) for at in range(item.count)]
    units = f" ({item.point.units})" if item.point.units else ""
    return [f"{name}{units}" for name in _names(item.point)]


def _whence(item: Item) -> dict[str, Any]:
    """Return the fields of JSON that name an item."""
    if item.point is not None:
        return {"name": item.point.name}
    fields: dict[str, Any] = {"table": item.table, "address": item.address + item.base}
    if item.bit is not None:
        fields["bit"] = item.bit
    return {**fields, "file": item.file} if item.table == "file" else fields


def _of_type(item: Item, kind: ValueType, cells: list[int]) -> _Shown:
    from ...maps.meaning import no_value

    values = kind.values_in(cells)
    if all(isinstance(value, ValueError) for value in values):
        place = f"{item.table.replace('_', ' ')} from {item.number()}"
        raise ValueError(f"{place} hold no {kind.name}: {values[0]}")
    rows = []
    # Values for which JSON has no number: they are null, and their texts stand here.
    texts = {}
    numbers: list[Any] = []
    for at, value in enumerate(values):
        where = item.number(at * item.size)
        if isinstance(value, ValueError):
            rows.append(ValueText(where, "-", "", f"({no_value(where, kind, value).reason})"))
            numbers.append(None)
        else:
            rows.append(ValueText(where, *_texts(value, kind)))
            is_short = kind.name in SHORT_FLOATS
            numbers.append(shortest(value, kind.name) if is_short else value)
        if isinstance(value, ValueError) or (isinstance(value, float) and not math.isfinite(value)):
            texts[str(item.address + item.base + at * item.size)] = str(value)
    fields = {"type": kind.name, "order": kind.order, "values": plain(numbers)}
    return rows, {**fields, "no_value": texts} if texts else fields


def _in_all_ways(item: Item, cells: list[int]) -> _Shown:
    """
    Return what registers mean, each with the number of its first register, plausible ones first:
    all interpretations as one value, and, from each register on, the likely ones of fewer.
    """
    from ...protocol.values import readings, value_type

    interpretations: list[tuple[int, Interpretation]] = []
    for at in range(len(cells)):
        sizes = [size for size in SIZES if size < len(cells) and at + size <= len(cells)]
        parts = [way for size in sizes for way in readings(cells[at : at + size])]
        parts.sort(key=lambda reading: reading.doubt)
        # One of a signed and an unsigned value that are equal is enough here.
        distinct: dict[str, Interpretation] = {}
        for part in parts:
            distinct.setdefault(repr(part.value), part)
        likely = [*distinct.values()][:LIKELY]
        if at == 0 and len(cells) <= MOST_AT_ONCE:
            likely = sorted([*readings(cells), *likely], key=lambda reading: reading.doubt)
        interpretations += [(at, way) for way in likely]
    width = max(len(reading.type) for _, reading in interpretations)
    orders = max(len(reading.order) for _, reading in interpretations)
    rows = [
        ValueText(
            f"{item.number(at):>{NUMBER_CHARACTERS}}  {name:<{width}}  {order:<{orders}}",
            *_texts(value, value_type(name)),
        )
        for at, (name, order, value) in interpretations
    ]
    first = item.address + item.base
    fields = [{"address": first + at, **plain(reading)} for at, reading in interpretations]
    return rows, {"registers": cells, "readings": fields}


def _of_point(item: Item, point: Point, cells: list[int], source: Any) -> ReadResult:
    judgement = point.judge(cells if item.kind else [bool(cell) for cell in cells], source=source)
    rows = rows_of_point(point, judgement.value, judgement.reason)
    fields = {"name": point.name, "value": plain(judgement.value)}
    if not judgement.reason:
        return ReadResult(item, rows, fields)
    fields["no_value"] = {"quality": judgement.quality, "reason": judgement.reason}
    return ReadResult(item, rows, fields, remark=f"{point.name}: {judgement.reason}")


def rows_of_point(point: Point, value: Any, reason: str) -> list[ValueText]:
    """Return each value of a point as text, or the reason why there is none."""
    values = value if point.count > 1 else [value]
    return [
        ValueText(name, "-", "", f"({reason})")
        if element is None
        else ValueText(name, *_texts_of_point(point, element), point.units)
        for name, element in zip(_names(point), values, strict=True)
    ]


def _names(point: Point) -> list[str]:
    if point.count == 1:
        return [point.name]
    return [f"{point.name}[{at}]" for at in range(point.count)]


def _texts_of_point(point: Point, value: Any) -> tuple[str, str]:
    kind = point.read.kind
    is_as_read = (point.scale, point.offset, point.scale_from) == (1, 0, None)
    is_named = isinstance(value, str) and point.states is not None
    if isinstance(value, dict):
        text = " ".join(f"{name}={int(bit)}" for name, bit in value.items())
    elif kind is not None and is_as_read and not is_named and not point.is_part:
        return _texts(value, kind)
    else:
        text = str(int(value) if isinstance(value, bool) else value)
    return text, text


def _texts(value: Any, kind: ValueType) -> tuple[str, str]:
    """Return a value for people, and for CSV."""
    text = text_of(value, kind)
    return text, value if isinstance(value, str) else text


# --- lines ---------------------------------------------------------------------------


def aligned(results: Sequence[ReadResult]) -> list[str]:
    """Return a line for each value, which begins with the table if there are several items."""
    several = len(results) > 1
    word = max((len(result.item.word) for result in results), default=0) if several else 0
    pairs = [(result.item, row) for result in results for row in result.rows]
    places = [row.where for item, row in pairs if item.word]  # neither references nor names
    width = max(map(len, places), default=0) if several else NUMBER_CHARACTERS
    wheres = [_where(item, row, word, width) for item, row in pairs]
    label = max(map(len, wheres), default=0)
    numbers = max((len(row.text) for item, row in pairs if not _is_text(item)), default=0)
    return [
        f"{where:<{label}}  {row.text:>{0 if _is_text(item) else numbers}} {row.unit}".rstrip()
        for where, (item, row) in zip(wheres, pairs, strict=True)
    ]


def _where(item: Item, row: ValueText, word: int, width: int) -> str:
    """Return the beginning of a line: a name, or a table and an address as wide as the others."""
    if item.point is not None or item.form == ALL or (word and not item.word):
        return row.where
    return f"{item.word:<{word}} {row.where:>{width}}" if word else f"{row.where:>{width}}"


def _is_text(item: Item) -> bool:
    """Return True if values are text, which is aligned at the left."""
    kind, point = item.kind, item.point
    is_named = point is not None and (point.states or point.bits) is not None
    return is_named or item.form == ALL or (kind is not None and (kind.is_text or kind.is_time))


def in_line(result: ReadResult, *, several: bool) -> str:
    """Return the values of an item in one line; several items are named."""
    item = result.item
    values = " ".join(f"{row.text} {row.unit}".rstrip() for row in result.rows)
    values = values or f"({result.failure})"
    values += " (fell)" * result.has_fallen
    if item.point is not None:
        return f"{item.point.name}={values}"
    return f"{item.label()}: {values}" if several else values


# --- printers ------------------------------------------------------------------------


Printer = Callable[[int, Sequence[ReadResult], str], None]
"""Prints the results of a unit, or the reason why there are none."""


def printer_of(
    options: argparse.Namespace, items: Sequence[Item], *, several: bool, are_polls: bool
) -> Printer:
    """Return the printer of results of several units, or of one; for polls also of the time."""
    if options.csv:
        return _CsvRows(items, has_unit=several, path=options.written_to).print
    if options.json:
        return partial(_print_object, has_time=are_polls)
    return partial(_print_line if are_polls else _print_lines, has_unit=several)


def _print_lines(unit: int, results: Sequence[ReadResult], reason: str, *, has_unit: bool) -> None:
    """Print a line for each value; of several units, and of one item, a line for each unit."""
    if reason:
        fail(unit, reason, as_json=False, lacks="values")
        return
    if has_unit and len(results) == 1 and results[0].item.form != ALL:
        print(f"unit {unit:<3}  {in_line(results[0], several=False)}", flush=True)
        return
    lines = aligned(results)
    if has_unit:
        lines = [f"unit {unit}:", *(f"  {line}" for line in lines)]
    if lines:
        print("\n".join(lines))


def _print_line(unit: int, results: Sequence[ReadResult], reason: str, *, has_unit: bool) -> None:
    """Print the time and the values of a poll; with their addresses if there are several."""
    several = len(results) > 1
    text = reason or "  ".join(in_line(result, several=several) for result in results)
    whence = f"unit {unit}  " if has_unit else ""
    print(f"{time_text(time.time())}  {whence}{text}", flush=True)


def _print_object(unit: int, results: Sequence[ReadResult], reason: str, *, has_time: bool) -> None:
    """Print an object of JSON: values by name, one item, or a list of items."""
    fields = {"error": reason} if reason else _fields(results)
    when = {"time": time_text(time.time())} if has_time else {}
    print_json({**when, "unit": unit, **fields})


def _fields(results: Sequence[ReadResult]) -> dict[str, Any]:
    items = [result.fields for result in results]
    if not all(result.item.point for result in results):
        return items[0] if len(items) == 1 else {"items": items}
    by_name = {
        key: {item["name"]: item[field] for item in items if field in item}
        for key, field in (("values", "value"), ("no_value", "no_value"), ("errors", "error"))
    }
    fell = [result.fields["name"] for result in results if result.has_fallen]
    others = {key: value for key, value in {**by_name, "fell": fell}.items() if value}
    return {"values": {}, **others}


class _CsvRows:
    """
    Prints a header, then a row for each poll: the time, the unit, the values and the error.

    A file that has these columns already gets no second header; one with others is a ValueError.
    """

    def __init__(self, items: Sequence[Item], *, has_unit: bool, path: str | None) -> None:
        self._titles = [title for item in items for title in _titles(item)]
        self._has_unit = has_unit
        self._header = ["time", *["unit"] * has_unit, *self._titles, "error"]
        self._gap = None if path is None else _gap(path, self._header)
        self._has_begun = False

    def print(self, unit: int, results: Sequence[ReadResult], reason: str) -> None:
        cells: list[str] = [] if results else [""] * len(self._titles)
        for result in results:
            cells += [row.plain for row in result.rows] or [""] * len(_titles(result.item))
        remarks = filter(None, (result.failure or result.remark for result in results))
        if not self._has_begun:
            self._has_begun = True
            if self._gap is None:
                print_csv([self._header])
            else:
                print(end=self._gap)
        whence = [time_text(time.time()), *[str(unit)] * self._has_unit]
        print_csv([[*whence, *cells, reason or "; ".join(remarks)]])


def _gap(path: str, header: list[str]) -> str | None:
    """
    Return what is written before rows are added to a file: nothing, or the end of its last line;
    None if it is empty. Raise ValueError if it has other columns.
    """
    if not os.path.getsize(path):
        return None
    from ...files.csv_text import csv_rows

    titles = csv_rows([header]).rstrip("\n")
    with open(path, "rb") as file:
        first = file.readline().decode(errors="replace").rstrip("\r\n")
        file.seek(-1, os.SEEK_END)
        is_whole = file.read() == b"\n"
    if first != titles:
        raise ValueError(f"{path} has the columns {first!r}, and not {titles!r}: name another file")
    return "" if is_whole else "\n"


class TerminalTable:
    """Draws a title, a line for each value with a mark after a change, and failures."""

    def __init__(self, title: str, units: Iterable[int], screen: TextIO) -> None:
        self._title = title
        # Unit -> its lines, each with True if its value has just changed.
        self._lines: dict[int, list[tuple[str, bool]]] = {unit: [] for unit in units}
        self._texts: dict[int, list[str]] = {}
        self._rounds = self._failed = 0
        self._last_failure = ""
        self._redrawn = RedrawnLines(screen)

    def print(self, unit: int, results: Sequence[ReadResult], reason: str) -> None:
        failures = [reason] if reason else [result.failure for result in results if result.failure]
        self._rounds += unit == next(iter(self._lines))
        now = clock_text(time.time())
        if failures:
            self._failed += 1
            self._last_failure = f", {self._failed} failed, last at {now}"
        lines = [] if reason else self._marked(unit, results)
        self._lines[unit] = [*lines, *((failure, False) for failure in failures)]
        title = f"{now}  {self._title}, {self._rounds} polls{self._last_failure}"
        lines_shown = [(title, False)]
        for unit_number, its_lines in self._lines.items():
            lines_shown += [(f"unit {unit_number}", False)] if len(self._lines) > 1 else []
            lines_shown += its_lines
        self._redrawn.draw(lines_shown)

    def _marked(self, unit: int, results: Sequence[ReadResult]) -> list[tuple[str, bool]]:
        """Return the lines of a unit; none is marked if the number of lines has changed."""
        texts = [row.text for result in results for row in result.rows]
        before = self._texts.get(unit, [])
        if len(before) != len(texts):
            before = texts
        self._texts[unit] = texts
        return [
            (f"{' ' if text == old else CHANGED} {line}", text != old)
            for line, text, old in zip(aligned(results), texts, before, strict=True)
        ]
