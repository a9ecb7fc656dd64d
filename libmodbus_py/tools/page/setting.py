"""
A value that somebody typed, into its cells: checked, under the lock, and looked at afterwards.

It is the device's own side that sets it, not a client: whatever clients may not write can be set,
and hooks about writes are not called. What a point cannot be, is refused.
"""

from __future__ import annotations

from typing import Any

from ...maps.point import Point
from ...protocol.spelling import bit_of, decimal_of, number_of, shown, value_of
from ...protocol.tables import TABLES
from ...protocol.values import readings, value_type
from .refreshing import Refreshing
from .shown import Unit

__all__ = ["readings_at", "set_cells", "set_point"]

MOST_TEXT = 2000


def set_point(unit: Unit, point: Point, text: str) -> None:
    """
    Raises:
        ValueError: it cannot be that, or the device computes it.
    """
    words = text.split(",") if point.count > 1 else [text]
    values = [_value(point, word if point.count == 1 else word.strip()) for word in words]
    try:
        cells = point.encode(values if point.count > 1 else values[0])
    except (TypeError, ValueError) as error:
        raise ValueError(str(error).removeprefix(f"{point.name}: ")) from None
    _set(unit, point.table, point.address, cells)


def set_cells(unit: Unit, table: str, address: int, text: str, type: str, order: str) -> range:
    """
    Set one value of a type from an address on; in tables of bits the type means nothing.

    Returns:
        The cells it took.

    Raises:
        ValueError: it cannot be that, or the device computes it, or lacks the cells.
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
    if type == "uint16" and text.strip().startswith("-"):
        text = str(_register(text))
    set_point(unit, point, text)
    return point.cells


def readings_at(unit: Unit, table: str, address: int) -> list[list[str]]:
    """Say what the cells from an address on may mean: type, order and value."""
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


def _register(text: str) -> int:
    """Signed and unsigned are the same 16 bits."""
    value = number_of("value", text)
    return value & 0xFFFF if value >= -0x8000 else value


def _value(point: Point, text: str) -> Any:
    if len(text) > MOST_TEXT:
        raise ValueError(f"value must have at most {MOST_TEXT} characters")
    kind = point.read.kind
    if kind is None:
        return bit_of(text.strip())
    if kind.limits is None:
        return value_of(text if kind.is_text else text.strip(), kind)
    if (point.scale, point.offset) == (1, 0):
        return value_of(text.strip(), kind)
    return decimal_of(text)


def _set(unit: Unit, table: str, address: int, cells: list[Any]) -> None:
    stop = address + len(cells)
    with unit.device.mapping as mapping:
        place = getattr(mapping, table)
        if not place.has(address, len(cells)):
            raise ValueError(f"the device lacks {table} {address}..{stop - 1}")
        place[address:stop] = cells
        Refreshing(unit.device).refresh(table, range(address, stop))
        if place[address:stop] != cells:
            raise ValueError("the device computes it itself: it moves")
