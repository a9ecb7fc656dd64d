"""
Register maps in device files: all their points exist, with values and moves by name.
"""

from __future__ import annotations

import os
from array import array
from collections.abc import Iterator, Mapping
from typing import Any

from ...maps.point import Point
from ...maps.register_map import RegisterMap
from ...protocol.tables import TABLE_SIZE, TABLES
from ...protocol.values import value_type
from ..files.maps.map_file import load_map
from ..files.toml_lines import below
from .checks import DeviceFileError, checked, inside, table
from .keys import MOVES
from .ranges import SCALED_CELLS, Budget, Range
from .runs import BIT, Behaviour, Kind, Run, ScaledType

__all__ = ["Maps", "mapped_points", "mapped_ranges"]

# Different ones of one device file; each takes as long as it.
MAX_MAPS = 50

REGISTER = value_type("uint16")


class Maps:
    """
    The register maps of one device file, each read once.

    Args:
        folder: where their paths begin.

    Attributes:
        files: those that were read, or could not be.
    """

    def __init__(self, folder: str) -> None:
        self._folder = folder
        self._maps: dict[str, RegisterMap] = {}

    @property
    def files(self) -> tuple[str, ...]:
        return tuple(self._maps)

    def get(self, where: str, name: str) -> RegisterMap:
        """
        Raises:
            DeviceFileError: it cannot be read, or there are too many.
        """
        path = os.path.normpath(os.path.join(self._folder, name))
        if path not in self._maps:
            if len(self._maps) >= MAX_MAPS:
                raise DeviceFileError(f"{where}: more than {MAX_MAPS} register maps in one file")
            self._maps[path] = RegisterMap(())
            try:
                self._maps[path] = load_map(path)
            except ValueError as error:  # a path with a 0 in it is no MapError
                raise DeviceFileError(f"{where}: {error}") from None
        return self._maps[path]


def mapped_points(
    where: str, unit: Mapping[str, Any], maps: Maps, budget: Budget
) -> dict[str, Point]:
    """Give the points of all maps of a unit, by name."""
    points: dict[str, Point] = {}
    for place, name in _names(f"{where}map", unit.get("map", [])):
        found = maps.get(place, name)
        budget.spend_points(place, len(found))
        for point in found.values():
            if point.name in points:
                raise DeviceFileError(f"{place}: there is a point {point.name} in a map before")
            points[point.name] = point
    return points


def _names(where: str, given: object) -> Iterator[tuple[str, str]]:
    if isinstance(given, str):
        yield where, given
        return
    if not isinstance(given, list):
        raise DeviceFileError(f"{where} must be the path of a register map, or a list of them")
    for at, name in enumerate(given):
        if not isinstance(name, str):
            raise DeviceFileError(f"{where}[{at}] must be the path of a register map")
        yield f"{where}[{at}]", name


def mapped_ranges(
    where: str, unit: Mapping[str, Any], points: Mapping[str, Point], budget: Budget
) -> list[Range]:
    """
    Make ranges of points.

    Points may share cells. What moves is one range then, and those that can be written come
    before others; what no range has of a point is a plain one.
    """
    moves = {
        name: _behaviour(place, raw) for name, place, raw in _by_name(where, "moves", unit, points)
    }
    image = _image(where, unit, points, moves, budget)
    order = sorted(
        points.values(), key=lambda each: (each.name not in moves, each.access != "read_write")
    )
    taken = {name: bytearray(TABLE_SIZE) for name in TABLES}
    found = []
    for point in order:
        cells = point.cells
        used = taken[point.table]
        place = f"{where}map, {point.name}"
        if used.find(1, cells.start, cells.stop) < 0:
            behaviour, move = moves.get(point.name, ("", None))
            run = Run(point.table, cells.start, point.count, _kind(point), move)
            access = "read" if move else str(point.access)
            found.append(_range(place, run, image, access, behaviour))
        elif point.name in moves:
            key = below(f"{where}moves", point.name)
            raise DeviceFileError(f"{key} shares cells with another that moves")
        else:
            kind = BIT if TABLES[point.table].is_bits else REGISTER
            for start, stop in _free(used, cells):
                run = Run(point.table, start, stop - start, kind)
                found.append(_range(place, run, image, str(point.access), ""))
        used[cells.start : cells.stop] = b"\1" * len(cells)
    return found


def _by_name(
    where: str, key: str, unit: Mapping[str, Any], points: Mapping[str, Point]
) -> Iterator[tuple[str, str, Any]]:
    for name, value in unit.get(key, {}).items():
        place = below(f"{where}{key}", name)
        if name not in points:
            raise DeviceFileError(f"{place}: {_unknown(name, points)}")
        yield name, place, value


def _unknown(name: str, points: Mapping[str, Point]) -> str:
    if not points:
        return "there is no point, for the unit has no map"
    from difflib import get_close_matches

    close = get_close_matches(name, points, 3)
    return f"no such point{f'; close to it are {chr(44).join(close)}' if close else ''}"


def _behaviour(where: str, raw: object) -> tuple[str, Behaviour]:
    with inside(""):
        given = checked(f"{where}.", table(where, raw), MOVES)
    if len(given) != 1:
        raise DeviceFileError(f"{where} must have one of {', '.join(MOVES)}")
    ((name, behaviour),) = given.items()
    return name, behaviour


def _image(
    where: str,
    unit: Mapping[str, Any],
    points: Mapping[str, Point],
    moves: Mapping[str, object],
    budget: Budget,
) -> dict[str, array[int]]:
    """What is in the tables at first, by table."""
    zeros = bytes(2 * TABLE_SIZE)
    image: dict[str, array[int]] = {each.table: array("H", zeros) for each in points.values()}
    for name, place, value in _by_name(where, "values", unit, points):
        point = points[name]
        if name in moves:
            raise DeviceFileError(f"{place} means nothing beside moves.{name}")
        is_scaled = (point.scale, point.offset) != (1, 0)
        budget.spend(place, len(point.cells) * (SCALED_CELLS if is_scaled else 1))
        try:
            cells = point.encode(value)
        except (TypeError, ValueError) as error:
            message = str(error).removeprefix(f"{name}: value").removeprefix(f"{name}: ")
            raise DeviceFileError(f"{place}{message}") from None
        image[point.table][point.cells.start : point.cells.stop] = array("H", map(int, cells))
    return image


def _kind(point: Point) -> Kind:
    kind = point.read.kind
    if kind is None:
        return BIT
    if point.scale == 1 and point.offset == 0:
        return kind
    return ScaledType.of(kind, point.scale, point.offset)


def _range(
    where: str, run: Run, image: dict[str, array[int]], access: str, behaviour: str
) -> Range:
    cells = image[run.table][run.first : run.stop]
    if not any(cells):
        cells = cells[: run.kind.registers]
    return Range(where, run, cells, access, behaviour, is_mapped=True)


def _free(used: bytearray, cells: range) -> Iterator[tuple[int, int]]:
    """What nobody has of these cells: from, to."""
    start = used.find(0, cells.start, cells.stop)
    while start >= 0:
        end = used.find(1, start, cells.stop)
        stop = cells.stop if end < 0 else end
        yield start, stop
        start = used.find(0, stop, cells.stop)
