"""
Register maps in device files: all their points exist, with values and moves by name.
"""

from __future__ import annotations

import os
from array import array
from collections.abc import Iterator, Mapping
from typing import Any

from ...maps.point import Point
from ...maps.register_map import RegisterMap, close_to
from ...protocol.mistakes import Path, WrongValue, inside, placed
from ...protocol.tables import TABLE_SIZE, TABLES
from ..files.maps.map_file import load_map
from ..files.texts import shown_key
from .clockwork import Behaviour, SimulatedPoint
from .example_files import map_file
from .keys import MOVES
from .own_points import source_value

__all__ = ["Maps", "mapped_contents", "mapped_points"]


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
            source = source_value(point, given)
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
