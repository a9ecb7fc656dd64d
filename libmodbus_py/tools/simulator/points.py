"""
The points of simulated devices: those that a device file describes, with their addresses and
initial values, and those of its register maps, which all exist, with values and moves by name.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from typing import Any

from ...files.schema import REQUIRED, Key, Keys, a_list, flag, keys_of, whole
from ...files.texts import shown_key
from ...maps.list_words import ListOptions, options_of
from ...maps.map_file import POINT
from ...maps.point import Point
from ...maps.point_plan import scale_mistakes
from ...maps.register_map import RegisterMap, map_with
from ...maps.scaling import ELSE, NumberSpan, state_key
from ...protocol.mistakes import Path, WrongValue, close_to, inside, path_text
from ...protocol.pdu import RECORDS_PER_FILE
from ...protocol.tables import TABLES
from ...protocol.values import value_type
from .example_files import map_file
from .movements import BEHAVIOURS, SimulatedPoint

MOVES = Keys(
    Key(name, keys_of(make).but("point", "others").read) for name, make in BEHAVIOURS.items()
)
"""Kind of movement -> its keys."""

VALUES = Keys(
    [
        Key("value", text="the initial value of all"),
        Key("values", a_list, "the initial value of each, in place of `value` and `count`"),
    ]
)

POINT_KEYS = POINT.but("table", "initial")
"""The keys of a point; the name of the list is its table, its `value` the initial one."""

TYPING = POINT.only("type", "order", "encoding", "padding")


def _defaults(**values: Any) -> dict[str, Any]:
    """Check defaults of points: one of any type must be possible."""
    typing = {key: value for key, value in values.items() if key not in ("type", "access")}
    value_type(values.get("type", "string:1"), **typing)
    return values


DEFAULTS = Keys((TYPING | POINT.only("access")).optional().values(), _defaults)

# The keys of a point in a table.
_IN_TABLE = (
    POINT_KEYS.optional()
    | POINT.only("address")
    | Keys([Key("count", whole(1, 0x10000))])
    | VALUES
    | MOVES
)

CONTENTS: dict[str, Keys] = {
    **dict.fromkeys(TABLES, _IN_TABLE),
    "file": Keys(
        [
            Key("number", whole(1, 0xFFFF), "the number of the file", REQUIRED),
            Key("record", whole(0, RECORDS_PER_FILE - 1), "the first record", REQUIRED),
            Key("count", whole(1, RECORDS_PER_FILE)),
        ]
    )
    | VALUES
    | TYPING
    | POINT.only("access"),
}
"""Table -> the keys of its points or records."""


class Maps:
    """The register maps of one device file, each read once; paths are relative to its folder."""

    def __init__(self, folder: str, options: ListOptions | None = None) -> None:
        self._folder = folder
        self._options = options
        self._maps: dict[tuple[str, str], RegisterMap] = {}

    @property
    def files(self) -> tuple[str, ...]:
        """The paths of the maps that were read, or could not be."""
        return tuple(dict.fromkeys(path for path, _ in self._maps))

    def get(self, where: Path, name: str, unit: Mapping[str, Any]) -> RegisterMap:
        """Return a map that the key at a path names: a file, or one of the package."""
        with inside(*where[:2]):
            options = self._options or options_of(unit)
        with inside(*where):
            path = os.path.normpath(os.path.join(self._folder, map_file(name)))
            key = path, repr(options)
            if key not in self._maps:
                self._maps[key] = RegisterMap(())
                self._maps[key] = map_with(path, options)
        return self._maps[key]


def points_of(path: Path, unit: Mapping[str, Any], maps: Maps) -> list[SimulatedPoint]:
    contents = list(_mapped_points(path, unit, maps))
    points = {content.point.name: content.point for content in contents}
    paths: dict[str, Path] = {}
    raws = [(table, at, raw) for table in CONTENTS for at, raw in enumerate(unit.get(table, ()))]
    for table, at, raw in raws:
        where = (*path, table, at)
        point = _own_point(where, table, raw, unit["defaults"])
        name = point.point.name
        if not point.file:
            if name in points:
                raise WrongValue.about((*where, "name"), f"there is already a point {name}")
            points[name], paths[name] = point.point, where
        contents.append(point)
    for name, mistake in scale_mistakes(points):
        raise mistake.renamed(paths[name])
    _check_overlaps(contents)
    return contents


def _own_point(
    path: Path, table: str, raw: dict[str, object], defaults: Mapping[str, Any]
) -> SimulatedPoint:
    """Return a point of the device file itself, or the records of a file, which are alike."""
    content: dict[str, Any] = CONTENTS[table].read(path, raw)
    sources = [key for key in content if key in VALUES or key in MOVES]
    if len(sources) > 1:
        raise WrongValue((*path, sources[1]), f"cannot be given together with {sources[0]}")
    source = sources[0] if sources else ""
    behaviour = (source, content[source]) if source in MOVES else None
    if behaviour and content.get("access", "read") != "read":
        # A value written by a client would be lost at the next read.
        raise WrongValue((*path, "access"), "must be read for what moves by itself")
    if source == "values" and "count" in content:
        raise WrongValue((*path, "count"), "cannot be given together with values")
    if content.get("values") == []:
        raise WrongValue((*path, "values"), "must not be empty")
    first = content["record" if table == "file" else "address"]
    rules = TABLES.get(table)
    without = {*TYPING} if rules is not None and rules.is_bits else set()
    if behaviour or (rules is not None and not rules.most_written):
        without.add("access")
    keys = {
        **{key: value for key, value in defaults.items() if key not in without},
        "name": f"{table}_{first}",
        "count": len(content.get("values", " ")),
        **{key: value for key, value in content.items() if key in POINT_KEYS},
        "table": "holding_registers" if table == "file" else table,
        "address": first,
    }
    with inside(*path):
        point = Point(**keys)
    if table == "file" and point.cells.stop > RECORDS_PER_FILE:
        raise WrongValue(path, f"ends at {point.cells.stop - 1}, after {RECORDS_PER_FILE - 1}")
    # A text may be padded with other than zeros.
    is_text = point.read.kind is not None and point.read.kind.is_text and behaviour is None
    value = content.get("value", "" if is_text else None)
    value = _bits_of((*path, "value"), point, value)
    if rules is not None and rules.is_bits and isinstance(value, list):
        content["values"] = value
    if value is not None or "values" in content:
        values = content.get("values", [value] * point.count)
        value = values if point.count > 1 else values[0]
    return SimulatedPoint(path, point, value, behaviour, (*path, source), content.get("number", 0))


def _bits_of(path: Path, point: Point, value: object) -> object:
    """Return the bits that a table says of coils or a list of bits; other values as they are."""
    if not isinstance(value, dict):
        return value
    if TABLES[point.table].is_bits and not point.states:
        coils = _bits_in(path, value, point.cells)
        return coils if point.count > 1 else coils[0]
    is_list = str(point.type).startswith("bits") and not point.bits and not point.is_part
    is_one = is_list and point.count == 1
    return _bits_in(path, value, range(16 * len(point.cells))) if is_one else value


def _bits_in(path: Path, table: Mapping[str, object], numbers: range) -> list[bool]:
    """Return the bits that a table says by number or range, as {3 = true, "4..7" = true} does."""
    bits: dict[int, bool] = {}
    others = False
    for key, value in table.items():
        is_on = flag((*path, key), value)
        bit = state_key((*path, key), key, (numbers[0], numbers[-1]), None)
        if bit == ELSE:
            others = is_on
            continue
        low, high = (bit.low, bit.high) if isinstance(bit, NumberSpan) else (bit, bit)
        for number in range(int(low), int(high) + 1):
            if number in bits:
                raise WrongValue.about((*path, key), f"{number} is given twice")
            bits[number] = is_on
    return [bits.get(number, others) for number in numbers]


def _mapped_points(path: Path, unit: Mapping[str, Any], maps: Maps) -> Iterator[SimulatedPoint]:
    points: dict[str, Point] = {}
    for where, name in unit.get("map", ()):
        for point in maps.get(where, name, unit).values():
            if point.name in points:
                raise WrongValue.about(where, f"an earlier map has a point {point.name}, too")
            points[point.name] = point
    values, moves = unit.get("values", {}), unit.get("moves", {})
    for key, names in (("values", values), ("moves", moves)):
        for name in names:
            if name not in points:
                reason = f"no such point{close_to(name, points)}"
                raise WrongValue.about((*path, key, shown_key(name)), reason)
    for name, point in points.items():
        key = shown_key(name)
        source: Path = (*path, "values", key)
        behaviour = None
        if name in values and name in moves:
            raise WrongValue(source, f"cannot be given together with moves.{key}")
        if name in moves:
            source = (*path, "moves", key)
            read = MOVES.read(source, moves[name])
            if len(read) != 1:
                raise WrongValue(source, f"must have one of {', '.join(MOVES)}")
            source = (*source, *read)
            behaviour = next(iter(read.items()))
        where = (*path, "map", key)
        value = None if behaviour else values.get(name, point.initial)
        value = _bits_of(source, point, value)
        yield SimulatedPoint(where, point, value, behaviour, source, is_mapped=True)


def _check_overlaps(points: Iterable[SimulatedPoint]) -> None:
    """Raise WrongValue for points that share cells, and are neither parts nor of maps."""
    in_order = sorted(points, key=lambda point: (point.area, point.span.start))
    moving = [point for point in in_order if point.is_mapped and point.behaviour]
    for before, after in pairwise(moving):
        if before.table == after.table and after.span.start < before.span.stop:
            raise WrongValue(after.source[:-1], "shares cells with another that moves")
    last, bits = None, 0
    for point in in_order:
        own_bits = _bits(point)
        if last is None or last.area != point.area or last.span.stop <= point.span.start:
            last, bits = point, own_bits
        elif last.is_mapped and point.is_mapped:
            last = max(last, point, key=lambda point: point.span.stop)
        elif last.span == point.span and bits and own_bits and not bits & own_bits:
            bits |= own_bits
        else:
            around = f"{path_text(last.path)} ({last.span.start}..{last.span.stop - 1})"
            raise WrongValue(point.path, f"begins at {point.span.start}, within {around}")


def _bits(point: SimulatedPoint) -> int:
    """Return the bits of a point in its registers; 0 if it cannot share them."""
    is_whole = point.file or point.is_mapped or point.behaviour or not point.point.is_part
    return 0 if is_whole else point.point.meaning.mask
