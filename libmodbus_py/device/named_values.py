"""
Values of a device by the names of its points: read, and set all or none.
"""

from __future__ import annotations

from collections.abc import Mapping as MappingABC
from typing import Any

from ..maps.point import Point
from ..maps.register_map import RegisterMap, close_to
from ..maps.writing import encoded_changes
from ..protocol.mistakes import WrongType, WrongValue
from ..protocol.tables import TABLES
from .mapping import Mapping
from .ranges import joined

__all__ = ["check_points", "known_point", "set_values", "source_of", "value_of", "zeros_for"]


NOTHING: MappingABC[str, Any] = {}


def check_points(mapping: Mapping, points: object) -> None:
    """
    Raises:
        TypeError: `points` is no RegisterMap.
        ValueError: a point has cells that the mapping lacks; the message names it.
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
        TypeError: the argument is no RegisterMap.
    """
    if not isinstance(map, RegisterMap):
        raise WrongType("map", f"must be a RegisterMap, not {type(map).__name__}")
    places: dict[str, list[range]] = {table: [] for table in TABLES}
    for point in map.values():
        places[point.table].append(point.cells)
    return Mapping(**{table: joined(ranges) for table, ranges in places.items()})


def known_point(points: MappingABC[str, Point], name: object) -> Point:
    """
    Raises:
        KeyError: there is no point of this name; names close to it are in the message.
    """
    if isinstance(name, str) and name in points:
        return points[name]
    raise KeyError(f"the device has no point {name!r}{close_to(name, points)}")


def value_of(mapping: Mapping, points: MappingABC[str, Point], point: Point) -> Any:
    """
    Return the value of a point; None for no value.

    Args:
        points: all points of the device, by name, with those that scale others.

    Raises:
        ValueError: its cells hold none of its type.
    """
    cells = getattr(mapping, point.table)[point.cells.start : point.cells.stop]
    return point.decode(cells, source=source_of(mapping, points, point))


def source_of(
    mapping: Mapping,
    points: MappingABC[str, Point],
    point: Point,
    values: MappingABC[str, Any] = NOTHING,
) -> Any:
    """
    Return the value of the point that scales another; None without one.

    Args:
        values: new values by name, that are set, too.
    """
    if point.scale_from is None:
        return None
    if point.scale_from in values:
        return values[point.scale_from]
    return value_of(mapping, points, known_point(points, point.scale_from))


def set_values(
    mapping: Mapping, points: MappingABC[str, Point], values: MappingABC[str, Any]
) -> None:
    """
    Set values of points, all of them or none. Hold the mapping's lock.

    Raises:
        KeyError: there is no such point.
        TypeError, ValueError: a value does not fit its point, or points share cells.
    """
    if not isinstance(values, MappingABC):
        raise WrongType("values", f"must be by names, not {type(values).__name__}")
    changed = [(known_point(points, name), value) for name, value in values.items()]
    changes = [
        (point, value, source_of(mapping, points, point, values)) for point, value in changed
    ]
    for point, cells, masks in encoded_changes(changes):
        place, span = getattr(mapping, point.table), slice(point.cells.start, point.cells.stop)
        if masks is not None:
            pairs = zip(place[span], masks, strict=True)
            cells = [kept & ~mask | bits for (kept, mask), bits in zip(pairs, cells, strict=True)]
        place[span] = cells
