"""
The points that a device file itself describes: their addresses and initial values.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

from ...maps.point import Point
from ...protocol.mistakes import Path, WrongValue, inside, path_text, placed
from ...protocol.pdu import RECORDS_PER_FILE
from ...protocol.tables import TABLES
from ...protocol.values import value_type
from .clockwork import SimulatedPoint
from .keys import CONTENTS, DEFAULTS, MOVES, POINT_KEYS, TYPING, VALUES

__all__ = [
    "check_overlaps",
    "checked_defaults",
    "own_points",
    "source_value",
    "without_parts",
]


def own_points(
    path: Path, unit: Mapping[str, Any], defaults: dict[str, Any]
) -> list[SimulatedPoint]:
    """
    Return the points of the tables of a unit, and the records of its files.

    Args:
        path: path of the unit.

    Raises:
        TypeError, ValueError: the device file contains a mistake.
    """
    firsts = _first_values(unit)
    return [
        _point((*path, table, at), table, given, defaults, firsts)
        for table in CONTENTS
        for at, given in enumerate(unit.get(table, ()))
    ]


def _first_values(unit: Mapping[str, Any]) -> dict[str, Any]:
    """Return the initial values of points by name, which are not checked yet."""
    found: dict[str, Any] = {}
    for table in TABLES:
        for raw in unit.get(table, ()):
            name = raw.get("name", f"{table}_{raw.get('address')}")
            values = raw.get("values")
            first = values[0] if isinstance(values, list) and values else 0
            found.setdefault(str(name), raw.get("value", first))
    found |= unit.get("values", {})
    return found


def source_value(point: Point, firsts: Mapping[str, Any]) -> Any:
    """Return the first value of the point that scales another; 0 unless it is given."""
    if point.scale_from is None:
        return None
    value = firsts.get(point.scale_from, 0)
    return value if value or point.scale_as == "exponent" else None


def check_overlaps(found: Iterable[SimulatedPoint]) -> None:
    """
    Raises:
        WrongValue: two of the points share cells or records.
    """
    in_order = sorted(found, key=lambda each: (*each.area, each.first))
    for before, after in pairwise(in_order):
        if before.area == after.area and after.first < before.stop:
            taken = f"{path_text(before.path)} ({before.first}..{before.stop - 1})"
            raise WrongValue(after.path, f"begins at {after.first}, within {taken}")


def checked_defaults(path: Path, given: Mapping[str, Any]) -> dict[str, Any]:
    """
    Check the defaults of points.

    Args:
        path: path of the table around that of the defaults.

    Raises:
        TypeError, ValueError: no point could have such a default.
    """
    path = (*path, "defaults")
    found: dict[str, Any] = DEFAULTS.read(path, given.get("defaults", {}))
    options = {key: value for key, value in found.items() if key in TYPING and key != "type"}
    with inside(*path):
        value_type(found.get("type", "string:1"), **options)
    return found


def _point(
    path: Path,
    table: str,
    raw: dict[str, object],
    defaults: dict[str, Any],
    firsts: Mapping[str, Any],
) -> SimulatedPoint:
    given: dict[str, Any] = CONTENTS[table].read(path, raw)
    source = _source(path, given)
    behaviour = given[source] if source in MOVES else None
    given = _fitting(table, source in MOVES, defaults) | given
    values = given.get("values", [given[source]] if source == "value" else [])
    with inside(*path):
        point = _read_point(table, _count(given), given)
    last = point.cells.stop - 1
    if table == "file" and last >= RECORDS_PER_FILE:
        raise WrongValue(path, f"ends at {last}, after {RECORDS_PER_FILE - 1}")
    found = (*path, source)
    return SimulatedPoint(
        path,
        point,
        _initial_cells(found, point, values, source_value(point, firsts)),
        behaviour,
        found,
        file=given.get("number", 0),
        is_named="name" in given,
    )


def _source(path: Path, given: Mapping[str, Any]) -> str:
    """Return the key that sets the values; empty if there is none."""
    sources = [key for key in given if key in VALUES or key in MOVES]
    if len(sources) > 1:
        raise WrongValue((*path, sources[1]), f"cannot be given together with {sources[0]}")
    source = sources[0] if sources else ""
    if source in MOVES and given.get("access", "read") != "read":
        # A value written by a client would be lost at the next read.
        raise WrongValue((*path, "access"), "must be read for what moves by itself")
    return source


def _fitting(table: str, is_moving: bool, defaults: dict[str, Any]) -> dict[str, Any]:
    """Return the defaults that a point of this table can have."""
    without: set[str] = set()
    if table in TABLES and TABLES[table].is_bits:
        without |= set(TYPING)
    if is_moving or (table in TABLES and not TABLES[table].most_written):
        without |= {"access"}
    return {key: value for key, value in defaults.items() if key not in without}


def _count(given: Mapping[str, Any]) -> int:
    """Return the number of values of a point."""
    if "values" not in given:
        return int(given.get("count", 1))
    if "count" in given:
        raise WrongValue("count", "cannot be given together with values")
    if not given["values"]:
        raise WrongValue("values", "must not be empty")
    return len(given["values"])


def _read_point(table: str, count: int, given: Mapping[str, Any]) -> Point:
    """Return the point; records are read like registers."""
    first = given["record" if table == "file" else "address"]
    keys = {key: value for key, value in given.items() if key in POINT_KEYS}
    keys["count"] = count
    keys.setdefault("name", f"{table}_{first}")
    if table == "file":
        return Point(**keys, table="holding_registers", address=first)
    return Point(**{**keys, "table": table})


def _initial_cells(path: Path, point: Point, values: list[Any], source: Any = None) -> array[int]:
    """
    Return the initial cells of a point; those of one value if all values are the same.

    Args:
        path: path of the values, which ends with "value" if there is only one.
        values: one value, or all; none for the content of a device before the first write.
        source: the first value of the point that scales this one.

    Raises:
        TypeError, ValueError: the point cannot have such a value.
    """
    if not values:
        kind = point.read.kind
        is_text = kind is not None and kind.is_text
        return array("H", kind.encode("") if kind and is_text else [0] * point.read.size)
    cells = array("H")
    for at, value in enumerate(values):
        where = (*path, at) if path[-1] == "values" else path
        try:
            cells.extend(map(int, point.cells_of_one(value, point.scaling_for(source))))
        except (TypeError, ValueError) as error:
            raise placed(error, ()).renamed(where) from None
    return cells


# --- points that are different bits of the same registers ------------------------------------


def without_parts(
    found: Iterable[SimulatedPoint],
) -> tuple[list[SimulatedPoint], dict[str, Point]]:
    """
    Return the points, each with cells of its own, and by name the points that share their cells.

    The first point of some registers gets the initial bits of the others. Points that move, and
    those that have a bit in common, are all kept.
    """
    kept: dict[object, SimulatedPoint] = {}
    taken: dict[object, list[int]] = {}
    others: dict[str, Point] = {}
    for each in found:
        key: object = (each.area, each.first, each.stop)
        masks = _masks(each)
        if masks and key in taken and not any(map(int.__and__, masks, taken[key])):
            first = kept[key]
            bits = map(int.__or__, first.all_cells, each.all_cells)
            kept[key] = replace(first, cells=array("H", bits))
            taken[key] = list(map(int.__or__, masks, taken[key]))
            name = each.point.name
            while name in others:
                name += "_"
            others[name] = replace(each.point, name=name)
        elif masks and key not in kept:
            kept[key], taken[key] = each, masks
        else:
            kept[id(each)] = each
    return list(kept.values()), others


def _masks(each: SimulatedPoint) -> list[int]:
    """Return the bits of a point in each of its registers; none if it has whole registers."""
    point, kind = each.point, each.point.read.kind
    if not point.is_part or each.behaviour is not None or kind is None or each.file:
        return []
    assert point.meaning is not None
    return kind.cells_of_number(point.meaning.mask) * point.count
