"""
Values of the cells of named points: read, and set all or none.

Most servers have no points: what maps have is imported when the first device has some.
"""

from __future__ import annotations

from collections.abc import Mapping as MappingABC
from typing import TYPE_CHECKING, Any

from ..protocol.mistakes import WrongType, WrongValue, close_to
from ..protocol.tables import TABLES, joined
from .mapping import Mapping

if TYPE_CHECKING:
    from ..maps.meaning import CellChange
    from ..maps.point import Point
    from ..maps.register_map import RegisterMap

__all__ = ["NamedValues", "cells_after", "known_point", "source_after", "zeros_for"]

Written = MappingABC[tuple[str, int], Any]
"""Table and address -> the value that is written there."""

NOTHING: Written = {}


def check_points(mapping: Mapping, points: object) -> None:
    """Check that a mapping has the cells of all points; raise WrongType or WrongValue."""
    from ..maps.register_map import RegisterMap

    if not isinstance(points, RegisterMap):
        raise WrongType("points", f"must be a RegisterMap, not {type(points).__name__}")
    for point in points.values():
        table = getattr(mapping, point.table)
        if not table.has(point.address, len(point.cells)):
            span = f"{point.cells.start}..{point.cells.stop - 1}"
            raise WrongValue.about(point.name, f"{table!r} lacks its cells, {span}")


def zeros_for(map: object) -> Mapping:
    """
    Return a mapping with the cells of all points of a map, all zero; raise TypeError if it is none.
    """
    from ..maps.register_map import RegisterMap

    if not isinstance(map, RegisterMap):
        raise WrongType("map", f"must be a RegisterMap or a path, not {type(map).__name__}")
    places: dict[str, list[range]] = {table: [] for table in TABLES}
    for point in map.values():
        places[point.table].append(point.cells)
    return Mapping(**{table: joined(ranges) for table, ranges in places.items()})


def known_point(points: MappingABC[str, Point], name: object) -> Point:
    """Return the point of a name; raise KeyError with similar names if there is none."""
    if isinstance(name, str) and name in points:
        return points[name]
    raise KeyError(f"the device has no point {name!r}{close_to(name, points)}")


def cells_after(point: Point, mapping: Mapping, written: Written = NOTHING) -> list[Any]:
    """Return the cells of a point, as they will be after a write."""
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
    Return the value of the point that `scale_from` names, as it will be after a write; None for no
    value.
    """
    from ..maps.point_plan import sources_of

    value = None
    for source in sources_of([point], points).values():  # each scales the next one
        value = source.decode(cells_after(source, mapping, written), source=value)
    return value


def set_values(
    mapping: Mapping, points: MappingABC[str, Point], values: MappingABC[str, Any]
) -> None:
    """Set values of points by name, all of them or none. Hold the mapping's lock."""
    from ..maps.point_plan import sources_of
    from ..maps.writing import check_overlaps

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


class NamedValues:
    """
    The part of a `Device` that has values by name: ``device["setpoint"] = 21.5``.

    Raises:
        TypeError: `mapping` is no Mapping, or `points` no RegisterMap.
        ValueError: a point has cells that the mapping lacks; the message names it.

    Attributes:
        has_points: True if points were given.
    """

    def __init__(self, mapping: Mapping, points: RegisterMap | None) -> None:
        if not isinstance(mapping, Mapping):
            raise TypeError(f"mapping must be a Mapping, not {type(mapping).__name__}")
        if points is not None:
            check_points(mapping, points)
        self.mapping = mapping
        self.has_points: bool = points is not None
        self._points = points

    @property
    def points(self) -> RegisterMap:
        """The points by name; empty if none were given."""
        if self._points is None:
            from ..maps.register_map import RegisterMap

            return RegisterMap(())
        return self._points

    def __getitem__(self, name: str) -> Any:
        """
        Return the value of a point, without calling `before_read`; None if it has none.

        Raises:
            KeyError: there is no such point.
            ValueError: its cells hold no value of its type.
        """
        point = known_point(self.points, name)
        with self.mapping.lock:
            source = source_after(point, self.points, self.mapping)
            return point.decode(cells_after(point, self.mapping), source=source)

    def __setitem__(self, name: str, value: Any) -> None:
        """
        Set the value of a point; no hook is called.

        Raises:
            KeyError: there is no such point.
            TypeError, ValueError: as of `Point.encode`; the message names the point.
        """
        self.update({name: value})

    def update(self, values: MappingABC[str, Any]) -> None:
        """
        Set values of points by name, all of them or none. No hook is called.

        No request is answered while the values are set.

        Raises:
            KeyError: there is no such point.
            TypeError, ValueError: a value does not fit its point, or points share cells; the
                message names the points.
        """
        with self.mapping.lock:
            set_values(self.mapping, self.points, values)
