"""
Cells of points, and the points that an access to some cells touches.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable
from typing import NamedTuple

from ..maps.point import Point
from .access import Access

__all__ = ["Place", "PointIndex", "RuledCells"]

# A table, or "file", and the number of the file.
Place = tuple[str, int]


class RuledCells(NamedTuple):
    """
    Cells with one rule.

    Attributes:
        place: their table, or "file", and the number of the file.
        cells: their addresses.
        access: "read", "write" or "read_write"; None if only the bounds of the point count.
        point: the point whose values they hold.
    """

    place: Place
    cells: range
    access: str | None
    point: Point

    @classmethod
    def of(cls, point: Point) -> RuledCells:
        """Return the rule that a point has in its own table."""
        return cls((point.table, 0), point.cells, point.access, point)


class PointIndex:
    """Points by the addresses of their cells, which may overlap."""

    def __init__(self, ruled: Iterable[RuledCells]) -> None:
        self._rows: dict[Place, list[tuple[range, Point]]] = {}
        # The highest end of the cells up to each of them: none before it goes on further.
        self._ends: dict[Place, list[int]] = {}
        for each in sorted(ruled, key=lambda each: each.cells.start):
            ends = self._ends.setdefault(each.place, [])
            ends.append(max(each.cells.stop, ends[-1] if ends else 0))
            self._rows.setdefault(each.place, []).append((each.cells, each.point))

    def touched(self, access: Access) -> list[Point]:
        """Return the points that an access touches, in the order of their addresses."""
        place = access.table, access.file
        rows, ends = self._rows.get(place, ()), self._ends.get(place, ())
        first, stop = access.address, access.address + access.count
        found = []
        at = bisect_left(rows, stop, key=lambda row: row[0].start)
        while at and ends[at - 1] > first:
            at -= 1
            cells, point = rows[at]
            if cells.stop > first:
                found.append(point)
        return found[::-1]
