"""
Values of the cells of named points: read, and set all or none.
"""

from __future__ import annotations

from collections.abc import Mapping as MappingABC
from typing import Any

from ..maps.meaning import CellChange
from ..maps.point import Point
from ..maps.point_plan import sources_of
from ..maps.register_map import RegisterMap
from ..maps.writing import check_overlaps
from ..protocol.mistakes import WrongType, WrongValue, close_to
from ..protocol.tables import TABLES, joined
from .mapping import Mapping

# fmt: off
__all__ = [
    "Written", "cells_after", "check_points", "known_point", "set_values", "source_after",
    "zeros_for",
]
# fmt: on

Written = MappingABC[tuple[str, int], Any]
"""Table and address -> the value that is written there."""

NOTHING: Written = {}


def check_points(mapping: Mapping, points: object) -> None:
    """
    Check that a mapping has the cells of all points.

    Raises:
        WrongType, WrongValue: it lacks cells of one, or `points` is no RegisterMap.
    """
    if not isinstance(points, RegisterMap):
        raise WrongType("points", f"must be a RegisterMap, not {type(points).__name__}")
    for point in points.values():
        table = getattr(mapping, point.table)
        if not table.has(point.address, len(point.cells)):
            span = f"{point.cells.start}..{point.cells.stop - 1}"
            raise WrongValue.about(point.name, f"{table!r} lacks its cells, {span}")


def zeros_for(map: object) -> Mapping:
    """
    Return a mapping with the cells of all points of a map, all zero.

    Raises:
        TypeError: the argument is not a RegisterMap.
    """
    if not isinstance(map, RegisterMap):
        raise WrongType("map", f"must be a RegisterMap or a path, not {type(map).__name__}")
    places: dict[str, list[range]] = {table: [] for table in TABLES}
    for point in map.values():
        places[point.table].append(point.cells)
    return Mapping(**{table: joined(ranges) for table, ranges in places.items()})


def known_point(points: MappingABC[str, Point], name: object) -> Point:
    """
    Return the point of a name.

    Raises:
        KeyError: there is no point of this name; the message lists similar names.
    """
    if isinstance(name, str) and name in points:
        return points[name]
    raise KeyError(f"the device has no point {name!r}{close_to(name, points)}")


def cells_after(point: Point, mapping: Mapping, written: Written = NOTHING) -> list[Any]:
    """
    Return the cells of a point, as they will be after a write.

    Raises:
        IndexError: the mapping lacks some of them.
    """
    table, cells = point.table, point.cells
    found: list[Any] = getattr(mapping, table)[cells.start : cells.stop]
    if not written:
        return found
    pairs = zip(cells, found, strict=True)
    return [written.get((table, address), value) for address, value in pairs]


def source_after(
    point: Point, points: MappingABC[str, Point], mapping: Mapping, written: Written = NOTHING
) -> Any:
    """
    Return the value of the point that `scale_from` names, as it will be after a write.

    Args:
        points: all points of the device, by name.

    Returns:
        The value; None for no value, or without `scale_from`.

    Raises:
        IndexError: the mapping lacks cells of it.
        KeyError: there is no such point.
        ValueError: the cells will hold no value of its type.
    """
    value = None
    for source in sources_of([point], points).values():  # each scales the next one
        value = source.decode(cells_after(source, mapping, written), source=value)
    return value


def set_values(
    mapping: Mapping, points: MappingABC[str, Point], values: MappingABC[str, Any]
) -> None:
    """
    Set values of points by name, all of them or none. Hold the mapping's lock.

    Raises:
        KeyError, TypeError, ValueError: as `NamedValues.update`.
    """
    if not isinstance(values, MappingABC):
        raise WrongType(
            "values", f"must be a mapping from names to values, not {type(values).__name__}"
        )
    changed = {name: known_point(points, name) for name in values}
    # What scales comes first: the others are scaled by what its cells then hold.
    scales = [name for name in sources_of(changed.values(), points) if name in changed]
    changes: list[tuple[Point, CellChange]] = []
    written: dict[tuple[str, int], Any] = {}
    for name in dict.fromkeys([*scales, *changed]):
        point = changed[name]
        source = source_after(point, points, mapping, written)
        change = point.change(values[name], source=source)
        changes.append((point, change))
        cells = change.over(cells_after(point, mapping, written))
        written |= {(point.table, at): cell for at, cell in zip(point.cells, cells, strict=True)}
    check_overlaps(changes)
    for point in changed.values():
        table, cells = getattr(mapping, point.table), cells_after(point, mapping, written)
        table[point.cells.start : point.cells.stop] = cells
