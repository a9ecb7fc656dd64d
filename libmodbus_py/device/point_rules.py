"""
Rules of points for the requests of clients: what may be read, written, and with which values.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Callable, Iterable
from collections.abc import Mapping as MappingABC
from typing import NamedTuple

from ..maps.point import Point
from ..maps.writing import check_cells
from ..protocol.errors import IllegalDataAddress, IllegalDataValue
from ..protocol.tables import TABLES, joined, touches, without
from .access import Access, TableOrFile, Touched
from .mapping import Mapping
from .named_values import cells_after, source_after

__all__ = ["PointIndex", "PointRules", "RuledCells"]

Ranges = tuple[range, ...]


class RuledCells(NamedTuple):
    """The cells of a point in a table or file; `access` is None if only its bounds count."""

    place: TableOrFile
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
        self._rows: dict[TableOrFile, list[tuple[range, Point]]] = {}
        # The highest end of the cells up to each of them: none before it goes on further.
        self._ends: dict[TableOrFile, list[int]] = {}
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


class PointRules:
    """
    Access and bounds of points, which are checked before any hook is called.

    A cell may be read if one of its points may be read, and written if one of them may be
    written; a cell of no point has no rule.

    Args:
        ruled: the cells that have rules.
        points: returns all points of the device by name, with those that scale others.

    Attributes:
        reads, writes: ``{Access.table: ranges}``, the addresses for which there is something to
            check; of "file" the numbers of the files.
    """

    def __init__(
        self,
        ruled: Iterable[RuledCells],
        points: Callable[[], MappingABC[str, Point]] = dict,
    ) -> None:
        given = list(ruled)
        self._points = points
        self._unreadable = _refused(given, "write")
        self._unwritable = _refused(given, "read")
        bounded = [
            each
            for each in given
            if each.point.has_bounds
            and each.access != "read"
            and each.point.is_writable
            and each.place[0] in TABLES
        ]
        self._bounded = PointIndex(bounded)
        self.reads: dict[str, Ranges] = _by_table(self._unreadable.items())
        in_bounds = [(each.place, (each.cells,)) for each in bounded]
        self.writes: dict[str, Ranges] = _by_table([*self._unwritable.items(), *in_bounds])

    def check(self, touched: Touched, mapping: Mapping) -> None:
        """
        Check the accesses of a request to addresses that exist. Hold the mapping's lock.

        Raises:
            IllegalDataAddress: a cell may not be read, or not be written.
            IllegalDataValue: a point would have a value out of its bounds.
        """
        for access in touched.writes:
            _check(self._unwritable, access, "written")
        for access in touched.reads:
            _check(self._unreadable, access, "read")
        bounded = [point for each in touched.writes for point in self._bounded.touched(each)]
        if not bounded:
            return
        # A request may write only some of the cells of a point.
        written = {
            (write.table, address): value
            for write in touched.writes
            for address, value in enumerate(write.values, write.address)
        }
        try:
            for point in bounded:
                source = source_after(point, self._points(), mapping, written)
                check_cells(point, cells_after(point, mapping, written), source=source)
        except ValueError as error:
            raise IllegalDataValue(str(error)) from None


def _check(refused: dict[TableOrFile, Ranges], access: Access, verb: str) -> None:
    ranges = refused.get((access.table, access.file), ())
    if touches(ranges, access.address, access.count):
        span = f"{access.table} {access.address}..{access.address + access.count - 1}"
        raise IllegalDataAddress(f"{span} cannot all be {verb}")


def _refused(ruled: Iterable[RuledCells], refusing: str) -> dict[TableOrFile, Ranges]:
    """Return the cells whose points all have one access, by place."""
    refused: defaultdict[TableOrFile, list[range]] = defaultdict(list)
    others: defaultdict[TableOrFile, list[range]] = defaultdict(list)
    for each in ruled:
        if each.access is not None:
            (refused if each.access == refusing else others)[each.place].append(each.cells)
    return {
        place: left
        for place, ranges in refused.items()
        if (left := without(joined(ranges), joined(others[place])))
    }


def _by_table(found: Iterable[tuple[TableOrFile, Ranges]]) -> dict[str, Ranges]:
    """Return the cells by table; of "file" the numbers of the files."""
    tables: defaultdict[str, list[range]] = defaultdict(list)
    for (table, file), ranges in found:
        tables[table] += ranges if table in TABLES else [range(file, file + 1)]
    return {table: joined(ranges) for table, ranges in tables.items()}
