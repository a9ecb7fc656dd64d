"""
Named points: the values of their cells, which are set all or none; and their rules for the
requests of clients: what may be read and written, and with which values.

Most servers have no points: what maps have is imported when the first device has some.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Callable, Iterable
from collections.abc import Mapping as MappingABC
from typing import TYPE_CHECKING, Any, NamedTuple

from ..protocol.errors import IllegalDataAddress, IllegalDataValue
from ..protocol.mistakes import WrongType, WrongValue, close_to
from ..protocol.tables import TABLES, joined, touches, without
from .access import Access, Accesses, TableOrFile
from .mapping import Mapping

if TYPE_CHECKING:
    from ..maps.meaning import CellChange
    from ..maps.point import Point
    from ..maps.register_map import RegisterMap

Written = MappingABC[tuple[str, int], Any]
"""Table and address -> the value that is written there."""

NOTHING: Written = {}

Ranges = tuple[range, ...]


def zeros_for(map: RegisterMap) -> Mapping:
    """Return a mapping with the cells of all points of a map, all zero."""
    places: dict[str, list[range]] = {table: [] for table in TABLES}
    for point in map.values():
        places[point.table].append(point.cells)
    return Mapping(**{table: joined(ranges) for table, ranges in places.items()})


def known_point(points: MappingABC[str, Point], name: object) -> Point:
    """Return the point of a name; raise KeyError with similar names if there is none."""
    if isinstance(name, str) and name in points:
        return points[name]
    raise KeyError(f"the device has no point {name!r}{close_to(name, points)}")


def cells_after(point: Point, mapping: Mapping, writes: Written = NOTHING) -> list[Any]:
    table, cells = point.table, point.cells
    present: list[Any] = getattr(mapping, table)[cells.start : cells.stop]
    if not writes:
        return present
    pairs = zip(cells, present, strict=True)
    return [writes.get((table, address), value) for address, value in pairs]


def source_after(
    point: Point, points: MappingABC[str, Point], mapping: Mapping, writes: Written = NOTHING
) -> Any:
    """Return the value of what scales a point, as it will be after a write; None for no value."""
    from ..maps.point_plan import sources_of

    value = None
    for source in sources_of([point], points).values():  # each point scales the next one
        value = source.decode(cells_after(source, mapping, writes), source=value)
    return value


class NamedValues:
    """
    The part of a `Device` that has values by name: ``device["setpoint"] = 21.5``.

    Raises:
        TypeError: `mapping` is no Mapping, or `points` no RegisterMap.
        ValueError: a point has cells that the mapping lacks; the message names it.
    """

    def __init__(self, mapping: Mapping, points: RegisterMap | None) -> None:
        self._points = points
        if points is not None:
            from ..maps.register_map import RegisterMap

            if not isinstance(points, RegisterMap):
                raise WrongType("points", f"must be a RegisterMap, not {type(points).__name__}")
        self._mapping = self._checked_mapping(mapping)

    def _checked_mapping(self, mapping: Mapping) -> Mapping:
        """Return a mapping that has the cells of all points."""
        if not isinstance(mapping, Mapping):
            raise TypeError(f"mapping must be a Mapping, not {type(mapping).__name__}")
        for point in self.points.values() if self.has_points else ():
            table = getattr(mapping, point.table)
            if not table.has(point.address, len(point.cells)):
                span = f"{point.cells.start}..{point.cells.stop - 1}"
                raise WrongValue.about(point.name, f"{table!r} lacks its cells, {span}")
        return mapping

    @property
    def mapping(self) -> Mapping:
        """The four tables; another mapping may be set at any time, if it has all points."""
        return self._mapping

    @mapping.setter
    def mapping(self, mapping: Mapping) -> None:
        with self._mapping.lock:  # no request is answered meanwhile
            self._mapping = self._checked_mapping(mapping)
            self._arrange()

    def _arrange(self) -> None:
        """Compute again the values that depend on the tables; subclasses override this."""

    @property
    def has_points(self) -> bool:
        """True if points were given."""
        return self._points is not None

    @property
    def points(self) -> RegisterMap:
        """The points by name; empty if none were given."""
        if self._points is not None:
            return self._points
        from ..maps.register_map import RegisterMap

        return RegisterMap(())

    def __getitem__(self, name: str) -> Any:
        """
        Return the value of a point, without calling `before_read`; None if it has none.

        Raises:
            KeyError: there is no such point.
        """
        point = known_point(self.points, name)
        with self.mapping.lock:
            source = source_after(point, self.points, self.mapping)
            return point.decode(cells_after(point, self.mapping), source=source)

    def __setitem__(self, name: str, value: Any) -> None:
        """Set the value of a point, as `update` does."""
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
        from ..maps.point_plan import sources_of
        from ..maps.writing import check_overlaps

        if not isinstance(values, MappingABC):
            kind = type(values).__name__
            raise WrongType("values", f"must be a mapping from names to values, not {kind}")
        points = self.points
        targets = {name: known_point(points, name) for name in values}
        # Scales are set first: other values are scaled by the new cells of their scale.
        scales = [name for name in sources_of(targets.values(), points) if name in targets]
        changes: list[tuple[Point, CellChange]] = []
        writes: dict[tuple[str, int], Any] = {}
        with self.mapping as mapping:
            for name in dict.fromkeys([*scales, *targets]):
                point = targets[name]
                source = source_after(point, points, mapping, writes)
                change = point.change(values[name], source=source)
                changes.append((point, change))
                after = change.over(cells_after(point, mapping, writes))
                cells = zip(point.cells, after, strict=True)
                writes |= {(point.table, at): cell for at, cell in cells}
            check_overlaps(changes)
            for point in targets.values():
                table = getattr(mapping, point.table)
                table[point.cells.start : point.cells.stop] = cells_after(point, mapping, writes)


class RuledCells(NamedTuple):
    """The cells of a point in a table or file; `access` is None if only its bounds count."""

    place: TableOrFile
    cells: range
    access: str | None
    point: Point

    @classmethod
    def of(cls, point: Point) -> RuledCells:
        return cls((point.table, 0), point.cells, point.access, point)


class PointIndex:
    """Points by the addresses of their cells, which may overlap."""

    def __init__(self, cells_of_rules: Iterable[RuledCells]) -> None:
        self._rows: defaultdict[TableOrFile, list[tuple[range, Point]]] = defaultdict(list)
        for rule in sorted(cells_of_rules, key=lambda rule: rule.cells.start):
            self._rows[rule.place].append((rule.cells, rule.point))

    def touched(self, access: Access) -> list[Point]:
        """Return the points that an access touches, in the order of their addresses."""
        rows = self._rows.get((access.table, access.file), [])
        first, stop = access.address, access.address + access.count
        end = bisect_left(rows, stop, key=lambda row: row[0].start)
        return [point for cells, point in rows[:end] if cells.stop > first]


class PointRules:
    """
    Access and bounds of points, which are checked before any hook is called.

    A cell may be read if one of its points may be read, and written if one of them may be
    written; a cell of no point has no rule. `reads` and `writes` are the addresses for which there
    is something to check, by `Access.table`; of "file" the numbers of the files.
    """

    def __init__(
        self,
        cells_of_rules: Iterable[RuledCells],
        points: Callable[[], MappingABC[str, Point]] = dict,  # all points, and their scales
    ) -> None:
        rules = list(cells_of_rules)
        self._points = points
        self._unreadable = _refused(rules, "write")
        self._unwritable = _refused(rules, "read")
        cells_with_bounds = [
            rule
            for rule in rules
            if rule.point.has_bounds and rule.access != "read" and rule.point.is_writable
            if rule.place[0] in TABLES
        ]
        self._bounded = PointIndex(cells_with_bounds)
        self.reads: dict[str, Ranges] = _by_table(self._unreadable.items())
        in_bounds = [(rule.place, (rule.cells,)) for rule in cells_with_bounds]
        self.writes: dict[str, Ranges] = _by_table([*self._unwritable.items(), *in_bounds])

    def check(self, sides: Accesses, mapping: Mapping) -> None:
        """Refuse accesses to existing addresses that break a rule. Hold the mapping's lock."""
        for accesses, forbidden, verb in (
            (sides.writes, self._unwritable, "written"),
            (sides.reads, self._unreadable, "read"),
        ):
            for access in accesses:
                ranges = forbidden.get((access.table, access.file), ())
                if touches(ranges, access.address, access.count):
                    span = f"{access.table} {access.address}..{access.address + access.count - 1}"
                    raise IllegalDataAddress(f"{span} cannot all be {verb}")
        points = [point for access in sides.writes for point in self._bounded.touched(access)]
        if not points:
            return
        from ..maps.writing import check_cells

        # A request may write only some of the cells of a point.
        writes = {
            (write.table, address): value
            for write in sides.writes
            for address, value in enumerate(write.values, write.address)
        }
        try:
            for point in points:
                source = source_after(point, self._points(), mapping, writes)
                check_cells(point, cells_after(point, mapping, writes), source=source)
        except ValueError as error:
            raise IllegalDataValue(str(error)) from None


def _refused(cells_of_rules: Iterable[RuledCells], refusing: str) -> dict[TableOrFile, Ranges]:
    """Return the cells whose points all have one access, by place."""
    refusing_ranges: defaultdict[TableOrFile, list[range]] = defaultdict(list)
    others: defaultdict[TableOrFile, list[range]] = defaultdict(list)
    for rule in cells_of_rules:
        if rule.access is not None:
            (refusing_ranges if rule.access == refusing else others)[rule.place].append(rule.cells)
    return {
        place: rest
        for place, ranges in refusing_ranges.items()
        if (rest := without(joined(ranges), joined(others[place])))
    }


def _by_table(places: Iterable[tuple[TableOrFile, Ranges]]) -> dict[str, Ranges]:
    """Return the cells by table; of "file" the numbers of the files."""
    tables: defaultdict[str, list[range]] = defaultdict(list)
    for (table, file), ranges in places:
        tables[table] += ranges if table in TABLES else [range(file, file + 1)]
    return {table: joined(ranges) for table, ranges in tables.items()}
