"""
Typed values, into cells: checked, set under the lock, and compared afterwards.

They are set by the device's own side, not by a client: cells that clients cannot write can be set,
and hooks for writes are not called. Values that do not fit a point are refused.
"""

from __future__ import annotations

from typing import Any

from ...device.named_values import source_of
from ...maps.point import Point
from ...maps.typed import typed_register, typed_value
from ...protocol.spelling import shown
from ...protocol.tables import TABLES
from ...protocol.values import readings, value_type
from .refreshing import Refreshing
from .shown import ShownUnit

__all__ = ["readings_at", "set_cells", "set_point"]

MOST_TEXT = 2000


def set_point(unit: ShownUnit, point: Point, text: str) -> None:
    """
    Set a point to the value that a text says; several values are separated by commas.

    Raises:
        ValueError: the text is no such value, or the device computes the value itself.
    """
    _check_length(text)
    words = [each.strip() for each in text.split(",")] if point.count > 1 else [text]
    values = [typed_value(point, word) for word in words]
    _set_value(unit, point, values if point.count > 1 else values[0])


def set_cells(unit: ShownUnit, table: str, address: int, text: str, type: str, order: str) -> range:
    """
    Set one value of a type from an address on; in tables of bits the type is ignored.

    Returns:
        The addresses of the cells that were set.

    Raises:
        ValueError: the text is no such value, the device lacks the cells, or it computes the
            value itself.
    """
    is_bits = TABLES[table].is_bits
    try:
        point = Point(
            name="value",
            table=table,  # type: ignore[arg-type]
            address=address,
            type=None if is_bits else type,  # type: ignore[arg-type]
            order=order,  # type: ignore[arg-type]
        )
    except TypeError as error:
        raise ValueError(str(error)) from None
    _check_length(text)
    is_register = point.type == "uint16"
    _set_value(unit, point, typed_register(text) if is_register else typed_value(point, text))
    return point.cells


def readings_at(unit: ShownUnit, table: str, address: int) -> list[list[str]]:
    """Return type, order and value of each meaning of the cells from an address on."""
    if TABLES[table].is_bits:
        return []
    found = []
    for registers in (1, 2, 4):
        with unit.device.mapping as mapping:
            place = getattr(mapping, table)
            cells = place[address : address + registers] if place.has(address, registers) else []
        for type, order, value in readings(cells) if cells else []:
            found.append([type, order, shown(value, value_type(type, order=order))])
    return found


def _check_length(text: str) -> None:
    if len(text) > MOST_TEXT:
        raise ValueError(f"value must have at most {MOST_TEXT} characters")


def _set_value(unit: ShownUnit, point: Point, value: Any) -> None:
    with unit.device.mapping as mapping:
        try:
            source = source_of(mapping, {each.name: each for each in unit.points}, point)
            cells = point.cells_of(value, point.scaling_for(source))
            if point.is_part:
                place = getattr(mapping, point.table)
                before = place[point.cells.start : point.cells.stop]
                cells = point.put(before, value, source=source)
        except (TypeError, IndexError) as error:
            raise ValueError(str(error)) from None
        _set(unit, point.table, point.address, cells)


def _set(unit: ShownUnit, table: str, address: int, cells: list[Any]) -> None:
    stop = address + len(cells)
    with unit.device.mapping as mapping:
        place = getattr(mapping, table)
        if not place.has(address, len(cells)):
            raise ValueError(f"the device lacks {table} {address}..{stop - 1}")
        place[address:stop] = cells
        Refreshing(unit.device).refresh(table, range(address, stop))
        if place[address:stop] != cells:
            raise ValueError("the device computes this value itself")
