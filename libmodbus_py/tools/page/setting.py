"""
Sets cells to values that a person typed. Values are checked, set under the lock, and compared
afterwards.

The program of the device sets them, not a client: cells that clients cannot write can be set, and
hooks for writes are not called. Values that do not fit a point are refused.
"""

from __future__ import annotations

from typing import Any

from ...device.named_values import cells_after
from ...maps.point import Point
from ...maps.typed import typed_register, typed_value, typed_values
from ...protocol.spelling import text_of
from ...protocol.tables import TABLES
from ...protocol.values import readings, value_type
from .refreshing import Refreshing
from .shown import ShownUnit

__all__ = ["readings_at", "set_cells", "set_point"]

MOST_TEXT = 2000


def set_point(unit: ShownUnit, point: Point, text: str) -> None:
    """
    Set a point to the value, or the values, in a text, as `typed_values` reads them.

    Raises:
        ValueError: the text is not such a value, or the device computes the value itself.
    """
    _check_length(text)
    value = typed_values(point, text)
    with unit.device.mapping as mapping:
        try:
            unit.device.update({point.name: value})
        except TypeError as error:
            raise ValueError(str(error)) from None
        _check_set(unit, point, cells_after(point, mapping))


def set_cells(unit: ShownUnit, table: str, address: int, text: str, type: str, order: str) -> range:
    """
    Set cells from an address on to a value of a type; in tables of bits the type is ignored.

    Returns:
        The addresses of the cells that were set.

    Raises:
        ValueError: the text is not such a value, the device lacks the cells, or it computes the
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
    value = typed_register(text) if is_register else typed_value(point, text)
    with unit.device.mapping as mapping:
        place, span = getattr(mapping, table), point.cells
        if not place.has(address, len(span)):
            raise ValueError(f"the device lacks {table} {address}..{span.stop - 1}")
        place[address : span.stop] = cells = point.cells_of(value)
        _check_set(unit, point, cells)
    return point.cells


def readings_at(unit: ShownUnit, table: str, address: int) -> list[list[str]]:
    """Return type, order and value for each way to decode the cells from an address on."""
    if TABLES[table].is_bits:
        return []
    found = []
    for registers in (1, 2, 4):
        with unit.device.mapping as mapping:
            place = getattr(mapping, table)
            cells = place[address : address + registers] if place.has(address, registers) else []
        for type, order, value in readings(cells) if cells else []:
            found.append([type, order, text_of(value, value_type(type, order=order))])
    return found


def _check_length(text: str) -> None:
    if len(text) > MOST_TEXT:
        raise ValueError(f"value must have at most {MOST_TEXT} characters")


def _check_set(unit: ShownUnit, point: Point, cells: list[Any]) -> None:
    """
    Check that a point still has the cells that were set.

    Raises:
        ValueError: the point has other cells, because the device computes them when they are read.
    """
    Refreshing(unit.device).refresh(point.table, point.cells)
    if cells_after(point, unit.device.mapping) != cells:
        raise ValueError("the device computes this value itself")
