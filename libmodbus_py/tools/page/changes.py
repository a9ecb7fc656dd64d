"""
Changes that a person makes on the page of a server: values of points and cells, and faults.

The program of the device sets values, not a client: cells that clients cannot write can be set, and
hooks for writes are not called. Values that do not fit a point are refused. Values are checked, set
under the lock, and compared afterwards.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from ...device.named_values import cells_after
from ...maps.point import Point
from ...maps.typed import typed_register, typed_value, typed_values
from ...protocol.plain import text_of
from ...protocol.tables import TABLES
from ...protocol.values import readings, value_type
from ..faults.fault import Fault
from ..faults.switch import FaultSwitch
from .units import ShownUnit

__all__ = ["add_fault", "fault_rows", "readings_at", "set_cells", "set_point", "turn_fault"]

# Characters of a value that is typed.
MOST_TEXT = 2000

# Faults of a server to which pages can add others.
MOST_FAULTS = 200


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
    unit.refresh(point.table, point.cells)
    if cells_after(point, unit.device.mapping) != cells:
        raise ValueError("the device computes this value itself")


# --- faults ---------------------------------------------------------------------------------------


def fault_rows(switch: FaultSwitch) -> dict[int, list[Any]]:
    """Return unit, kind, settings and state of each fault, by its number, the oldest first."""
    return {
        each.number: [each.unit, each.fault.kind, _settings(each.fault), each.is_on]
        for each in sorted(switch.states(), key=lambda state: state.number)
    }


def turn_fault(switch: FaultSwitch, number: int, *, is_on: bool) -> None:
    """
    Switch a fault on or off.

    Raises:
        ValueError: the server does not have this fault any more.
    """
    found = [each for each in switch.states() if each.number == number]
    if not found:
        raise ValueError("this fault no longer exists")
    switch.turn(found[0], is_on=is_on)


def add_fault(switch: FaultSwitch, unit: int | None, fault: Fault) -> None:
    """
    Add a fault and switch it on; `unit` is None for every unit.

    Raises:
        ValueError: there are `MOST_FAULTS` already.
    """
    if len(switch.states()) >= MOST_FAULTS:
        raise ValueError(f"there are {MOST_FAULTS} faults already, which is the maximum")
    switch.switch_on(fault, unit=unit)


def _settings(fault: Fault) -> str:
    """Return all settings except the kind, such as ``seconds 1.5, function 3``."""
    given = {each.name: getattr(fault, each.name) for each in fields(fault) if each.name != "kind"}
    return ", ".join(
        f"{name} {value.hex(' ') if isinstance(value, bytes) else value}"
        for name, value in given.items()
        if value is not None
    )
