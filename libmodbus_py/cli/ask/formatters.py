"""
Values that were read, as lines of text, cells of CSV and fields of JSON.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from ...protocol.errors import ModbusError
from ...protocol.plain import plain, text_of
from ...protocol.values import Interpretation, ValueType, readings, value_type
from .items import ALL, HEX, REGISTERS, Item, reason_of

if TYPE_CHECKING:
    from ...maps.point import Point

__all__ = ["FormattedValue", "ReadResult", "aligned", "in_line", "result_of", "titles"]

NUMBER_CHARACTERS = 5
"""The width of an address, so that the addresses of several commands are below each other."""


class FormattedValue(NamedTuple):
    """
    One value as text.

    Attributes:
        where: the address or the name of the value.
        text, plain: the value for people, and for CSV.
        unit: the physical unit, such as "V"; the reason in brackets if there is no value.
    """

    where: str
    text: str
    plain: str
    unit: str = ""


class ReadResult(NamedTuple):
    """
    The result of one item.

    Attributes:
        rows: the values; empty after a failure.
        fields: the fields of JSON.
        failure: the reason of a failure; empty without one.
        remark: why a point has no value; empty without one.
        has_fallen: True for a total that is smaller than before.
    """

    item: Item
    rows: list[FormattedValue]
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
            rows, fields = _in_all_ways(cells)
        elif item.kind is not None:
            rows, fields = _of_type(item, item.kind, cells)
        else:
            form = "0x{:04X}" if item.form == HEX and _is_registers(item) else "{}"
            texts = [form.format(cell) for cell in cells]
            rows = [FormattedValue(item.number(at), text, text) for at, text in enumerate(texts)]
            fields = {"values": cells}
    except ValueError as error:
        return ReadResult(item, [], {**whence, "error": str(error)}, str(error))
    return ReadResult(item, rows, {**whence, **fields})


def titles(item: Item) -> list[str]:
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
    found: dict[str, Any] = {"table": item.table, "address": item.address + item.base}
    return {**found, "file": item.file} if item.table == "file" else found


def _is_registers(item: Item) -> bool:
    return item.table in (*REGISTERS, "fifo_queue")


def _of_type(
    item: Item, kind: ValueType, cells: list[int]
) -> tuple[list[FormattedValue], dict[str, Any]]:
    try:
        values = kind.decode_many(cells)
    except ValueError as error:
        place = f"{item.table.replace('_', ' ')} from {item.number()}"
        raise ValueError(f"{place}: {error}") from None
    rows = [
        FormattedValue(item.number(at * item.size), *_texts(each, kind))
        for at, each in enumerate(values)
    ]
    fields = {"type": kind.name, "order": kind.order, "values": plain(values)}
    # Which JSON has no numbers for: the values are null, and their texts stand here.
    texts = {
        str(item.address + item.base + at * item.size): str(value)
        for at, value in enumerate(values)
        if isinstance(value, float) and not math.isfinite(value)
    }
    return rows, {**fields, "no_value": texts} if texts else fields


def _in_all_ways(cells: list[int]) -> tuple[list[FormattedValue], dict[str, Any]]:
    """Return every interpretation of registers as one value."""
    found: list[Interpretation] = readings(cells)
    if not found:
        raise ValueError(f"{len(cells)} registers can only be text, and these are not")
    width = max(len(reading.type) for reading in found)
    rows = [
        FormattedValue(f"{name:<{width}}  {order}", *_texts(value, value_type(name)))
        for name, order, value in found
    ]
    return rows, {"registers": cells, "readings": plain(found)}


def _of_point(item: Item, point: Point, cells: list[int], source: Any) -> ReadResult:
    found = point.judge(cells if item.kind else [bool(cell) for cell in cells], source=source)
    values = found.value if point.count > 1 else [found.value]
    rows = [
        FormattedValue(name, "-", "", f"({found.reason})")
        if value is None
        else FormattedValue(name, *_texts_of_point(point, value), point.units)
        for name, value in zip(_names(point), values, strict=True)
    ]
    fields = {"name": point.name, "value": plain(found.value)}
    if not found.reason:
        return ReadResult(item, rows, fields)
    fields["no_value"] = {"quality": found.quality, "reason": found.reason}
    return ReadResult(item, rows, fields, remark=f"{point.name}: {found.reason}")


def _names(point: Point) -> list[str]:
    if point.count == 1:
        return [point.name]
    return [f"{point.name}[{at}]" for at in range(point.count)]


def _texts_of_point(point: Point, value: Any) -> tuple[str, str]:
    kind = point.read.kind
    is_as_read = (point.scale, point.offset, point.scale_from) == (1, 0, None)
    is_named = isinstance(value, str) and point.states is not None
    if isinstance(value, dict):
        text = " ".join(f"{name}={int(each)}" for name, each in value.items())
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
    word = max((len(each.item.word) for each in results), default=0) if several else 0
    pairs = [(each.item, row) for each in results for row in each.rows]
    placed = [row.where for item, row in pairs if item.word]  # neither references nor names
    width = max(map(len, placed), default=0) if several else NUMBER_CHARACTERS
    wheres = [_where(item, row, word, width) for item, row in pairs]
    label = max(map(len, wheres), default=0)
    numbers = max((len(row.text) for item, row in pairs if not _is_text(item)), default=0)
    return [
        f"{where:<{label}}  {row.text:>{0 if _is_text(item) else numbers}} {row.unit}".rstrip()
        for where, (item, row) in zip(wheres, pairs, strict=True)
    ]


def _where(item: Item, row: FormattedValue, word: int, width: int) -> str:
    """Return what a line begins with: a name, or a table and a number below those of others."""
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
