"""
The points of a file that is a register map: the valid ones, and every mistake with its place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, NamedTuple

from ...maps.point import Point
from ...maps.point_plan import scale_mistakes
from ...protocol.mistakes import Path, WrongValue, placed
from .schema import keys_of
from .texts import FileError, FilePlace

__all__ = ["POINT", "Contents", "MapEntry", "MapError", "collected", "remarks"]

POINT = keys_of(Point)
"""The keys of a point, in every file that describes points."""


class MapError(FileError):
    """A file is not a valid register map; the message names file, line, column or key."""


class MapEntry(NamedTuple):
    """The description of one point in a file, not yet checked."""

    path: Path  # of the point in the file; empty in CSV, where a row is a point
    place: Callable[[Path], FilePlace]  # of a path in the file
    keys: Callable[[], Mapping[str, Any]]  # the arguments of `Point`, or a TypeError or ValueError


@dataclass
class Contents:
    """The content of a file, which is a map if there are no mistakes."""

    points: dict[str, Point] = field(default_factory=dict)
    entries: dict[str, MapEntry] = field(default_factory=dict)  # of each of these points
    mistakes: list[MapError] = field(default_factory=list)
    ignored: list[str] = field(default_factory=list)  # headings without a known meaning
    notes: list[str] = field(default_factory=list)  # how it was read, if not in the usual way

    def place(self, name: str) -> FilePlace:
        """Return the place of a point in the file."""
        entry = self.entries[name]
        return entry.place(entry.path)


def collected(contents: Contents, entries: Iterable[MapEntry], most: int) -> Contents:
    """Add the points of entries to contents, up to the mistake with the number `most`."""
    try:
        for entry in entries:
            _add(contents, entry)
            if len(contents.mistakes) == most:
                return contents
    except MapError as error:
        contents.mistakes.append(error)
    for name, mistake in scale_mistakes(contents.points) if not contents.mistakes else ():
        entry = contents.entries[name]
        path = (*entry.path, *mistake.path[1:])
        contents.mistakes.append(MapError.of(mistake.renamed(entry.path), entry.place(path)))
    del contents.mistakes[most:]
    if not contents.points and not contents.mistakes:
        contents.mistakes.append(MapError((), "it has no points"))
    return contents


def _add(contents: Contents, entry: MapEntry) -> None:
    """Add the point of an entry, or the mistake in it."""
    try:
        point: Point = POINT.read(entry.path, entry.keys())
        if point.name in contents.points:
            reason = f"{point.name!r} stands in {contents.place(point.name)} already"
            raise WrongValue((*entry.path, "name"), reason)
    except (TypeError, ValueError) as error:
        mistake = placed(error, ())
        contents.mistakes.append(MapError.of(mistake, entry.place(mistake.path)))
    else:
        contents.points[point.name] = point
        contents.entries[point.name] = entry


# --- a valid map that may not be what its author meant ---------------------------------------

# Table -> how references to it begin (PI-MBUS-300): a 5-digit one is an address, too.
_REFERENCES = {"holding_registers": range(40001, 50000), "input_registers": range(30001, 40000)}


def remarks(contents: Contents) -> Iterator[str]:
    """Yield a line for everything in a file that is allowed, and unlikely."""
    points = list(contents.points.values())
    yield from contents.notes
    if contents.ignored:
        yield f"columns that mean nothing here: {', '.join(contents.ignored)}"
    for table, span in _REFERENCES.items():
        addresses = [point.address for point in points if point.table == table]
        if addresses and all(address in span for address in addresses):
            yield (
                f"all addresses of {table} are in {span.start}..{span.stop - 1}: if these are"
                f" references, {span.start} for address 0, leave out the column with the table"
            )
    for first, second in pairwise(sorted(points, key=lambda point: (point.table, point.address))):
        are_parts = first.is_part and second.is_part  # which may be different bits
        is_within = first.table == second.table and second.address < first.cells.stop
        if is_within and not are_parts:
            place = contents.place(second.name)
            yield f"{place}: {second.name} overlaps {first.name} at {second.table} {second.address}"
    for name, point in contents.points.items():
        if point.scale < 0 and point.scale == int(point.scale):
            place = contents.place(name)
            yield f"{place}: {name} is multiplied by {point.scale}: no power of ten is meant?"
