"""
The points of simulated devices: those that a device file describes, with their addresses and
initial values, and those of its register maps, which all exist, with values and moves by name.
"""

from __future__ import annotations

import os
from array import array
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

from ...maps.point import Point
from ...maps.register_map import RegisterMap, close_to
from ...protocol.mistakes import Path, WrongValue, inside, path_text, placed
from ...protocol.pdu import RECORDS_PER_FILE
from ...protocol.tables import TABLE_SIZE, TABLES
from ...protocol.values import value_type
from ..files.map_file import load_map
from ..files.texts import shown_key
from .clockwork import Behaviour, SimulatedPoint
from .example_files import map_file
from .keys import CONTENTS, DEFAULTS, MOVES, POINT_KEYS, TYPING, VALUES

# fmt: off
__all__ = [
    "Maps", "check_overlaps", "checked_defaults", "mapped_contents", "mapped_points", "own_points",
    "without_parts",
]
# fmt: on


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


def _source_value(point: Point, firsts: Mapping[str, Any]) -> Any:
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
        _initial_cells(found, point, values, _source_value(point, firsts)),
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
    """Return the initial cells of a point; those of one value if all values are the same."""
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


# --- points of register maps ----------------------------------------------------------------------


class Maps:
    """
    The register maps of one device file, each read once.

    Args:
        folder: the folder to which their paths are relative.
        columns: of all of them, as for `load_map`.

    Attributes:
        files: paths of the maps that were read, or could not be.
    """

    def __init__(self, folder: str, columns: Mapping[str, str] | None = None) -> None:
        self._folder = folder
        self._columns = columns
        self._maps: dict[str, RegisterMap] = {}

    @property
    def files(self) -> tuple[str, ...]:
        return tuple(self._maps)

    def get(self, where: Path, name: str) -> RegisterMap:
        """
        Return a register map: a file, or one that comes with the package, by its name.

        Args:
            where: the path of the key that names the map.

        Raises:
            WrongValue: the map cannot be read.
        """
        with inside(*where):
            path = os.path.normpath(os.path.join(self._folder, map_file(name)))
        if path not in self._maps:
            self._maps[path] = RegisterMap(())
            with inside(*where):  # a path with a 0 in it is not a MapError
                self._maps[path] = load_map(path, columns=self._columns)
        return self._maps[path]


def mapped_points(unit: Mapping[str, Any], maps: Maps) -> dict[str, Point]:
    """
    Return the points of all maps of a unit, by name.

    Raises:
        WrongValue: a map cannot be read, or two have a point of one name.
    """
    points: dict[str, Point] = {}
    for path, name in unit.get("map", ()):
        for point in maps.get(path, name).values():
            if point.name in points:
                raise WrongValue.about(path, f"an earlier map has a point {point.name}, too")
            points[point.name] = point
    return points


def mapped_contents(
    path: Path, unit: Mapping[str, Any], points: Mapping[str, Point]
) -> list[SimulatedPoint]:
    """
    Return the points of a device that come from its maps, with values and moves.

    Points may share cells. Then a moving point stays whole, and writable points come
    before others; the remaining cells of a point become registers or bits of their own.

    Args:
        path: path of the unit.

    Raises:
        TypeError, ValueError: `values` or `moves` of the unit contain a mistake.
    """
    moves = {name: _behaviour(key, raw) for name, key, raw in _by_name(path, "moves", unit, points)}
    image = _image(path, unit, points, moves)
    order = sorted(
        points.values(), key=lambda each: (each.name not in moves, each.access != "read_write")
    )
    taken = {name: bytearray(TABLE_SIZE) for name in TABLES}
    found = []
    for point in order:
        cells = point.cells
        used = taken[point.table]
        where = (*path, "map", shown_key(point.name))
        if used.find(1, cells.start, cells.stop) < 0:
            moved_by, behaviour = moves.get(point.name, ((), None))
            found.append(_content(where, point, image, behaviour, moved_by))
        elif point.name in moves:
            key = (*path, "moves", shown_key(point.name))
            raise WrongValue(key, "shares cells with another that moves")
        else:
            for start, stop in _free(used, cells):
                rest = Point(point.name, point.table, start, stop - start, access=point.access)
                found.append(_content(where, rest, image))
        used[cells.start : cells.stop] = b"\1" * len(cells)
    return found


def _by_name(
    path: Path, key: str, unit: Mapping[str, Any], points: Mapping[str, Point]
) -> Iterator[tuple[str, Path, Any]]:
    for name, value in unit.get(key, {}).items():
        where = (*path, key, shown_key(name))
        if not points:
            raise WrongValue.about(where, "there is no point, because the unit has no map")
        if name not in points:
            raise WrongValue.about(where, f"no such point{close_to(name, points)}")
        yield name, where, value


def _behaviour(path: Path, raw: object) -> tuple[Path, Behaviour]:
    given = MOVES.read(path, raw)
    if len(given) != 1:
        raise WrongValue(path, f"must have one of {', '.join(MOVES)}")
    ((name, behaviour),) = given.items()
    return (*path, name), behaviour


def _image(
    path: Path,
    unit: Mapping[str, Any],
    points: Mapping[str, Point],
    moves: Mapping[str, object],
) -> dict[str, array[int]]:
    """Return the initial content of the tables, by table."""
    zeros = bytes(2 * TABLE_SIZE)
    image: dict[str, array[int]] = {each.table: array("H", zeros) for each in points.values()}
    given = unit.get("values", {})
    for name, where, value in _by_name(path, "values", unit, points):
        point = points[name]
        if name in moves:
            raise WrongValue(where, f"cannot be given together with moves.{name}")
        try:
            source = _source_value(point, given)
            before = image[point.table][point.cells.start : point.cells.stop]
            point.cells_of(value, point.scaling_for(source))  # whose errors begin with "value"
            cells = point.change(value, source=source).over(before)
        except (TypeError, ValueError) as error:
            raise placed(error, ()).renamed(where) from None
        image[point.table][point.cells.start : point.cells.stop] = array("H", map(int, cells))
    return image


def _content(
    path: Path,
    point: Point,
    image: dict[str, array[int]],
    behaviour: Behaviour | None = None,
    moved_by: Path = (),
) -> SimulatedPoint:
    cells = image[point.table][point.cells.start : point.cells.stop]
    if not any(cells):
        cells = cells[: point.read.size]
    return SimulatedPoint(path, point, cells, behaviour, moved_by, is_mapped=True)


def _free(used: bytearray, cells: range) -> Iterator[tuple[int, int]]:
    """Yield the free ranges of these cells: from, to."""
    start = used.find(0, cells.start, cells.stop)
    while start >= 0:
        end = used.find(1, start, cells.stop)
        stop = cells.stop if end < 0 else end
        yield start, stop
        start = used.find(0, stop, cells.stop)
