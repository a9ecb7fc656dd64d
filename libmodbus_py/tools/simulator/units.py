"""
The units of a device file, each made into a device.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import groupby
from typing import Any

from ...device.functions import DEFAULT_SERVER_ID, RecordFile
from ...device.mapping import Mapping as Tables
from ...maps.point import Point
from ...maps.point_plan import scale_mistakes
from ...protocol.checks import integer
from ...protocol.close_names import close_to
from ...protocol.mistakes import Path, WrongValue, inside
from ...protocol.pdu.interface import OBJECT_NAMES
from ...protocol.tables import TABLES
from ..files.schema import bytes_or_text
from ..files.toml_lines import shown_key
from .clockwork import Clockwork
from .keys import CONTENTS, FIFO, UNIT
from .mapped import Maps, mapped_contents, mapped_points
from .own_points import Budget, check_overlaps, checked_defaults, own_points
from .shared_registers import without_parts
from .simulated import SimulatedDevice
from .simulated_point import SimulatedPoint

__all__ = ["made_unit"]


def made_unit(
    path: Path,
    raw: dict[str, object],
    said: object,
    defaults: dict[str, Any],
    maps: Maps,
    clock: Callable[[], float],
    budget: Budget,
) -> tuple[int | None, SimulatedDevice]:
    """
    Return the device of a unit.

    Args:
        path: path of the unit in the file.
        said: the content of the file that identifies the unit, besides `defaults` and register
            maps.
        defaults: defaults of points, as in the file.
        maps: the source of register maps.

    Raises:
        TypeError, ValueError: the file contains a mistake.
    """
    given = UNIT.read(path, raw)
    defaults = defaults | checked_defaults(path, given)
    found = [
        each for table in CONTENTS for each in own_points(path, table, given, defaults, budget)
    ]
    named = found
    found, parts = without_parts(found)
    check_overlaps(found)
    points = mapped_points(given, maps, budget)
    if mapped := mapped_contents(path, given, points, budget):
        found += mapped
        check_overlaps(found)
    _check_names(named, points)
    _check_scales(named, points)
    in_tables = [each for each in found if each.table in TABLES]
    mapping = _mapping(in_tables, budget)
    clockwork = Clockwork(mapping, in_tables, clock)
    _start(clockwork, in_tables)
    device = SimulatedDevice(
        mapping,
        name=given.get("name", ""),
        description=given.get("description", ""),
        definition=(said, defaults, points),
        contents=found,
        mapped=points | parts,
        clockwork=clockwork,
        fifos=_fifos((*path, "fifo"), given),
        identification=_identification((*path, "identification"), given),
        server_id=DEFAULT_SERVER_ID._replace(**given.get("server_id", {})),
        exception_status=given.get("exception_status", 0),
        authorize=given.get("roles"),
    )
    device.files.update(_files([each for each in found if each.file], budget))
    return given.get("id"), device


def _start(clockwork: Clockwork, points: list[SimulatedPoint]) -> None:
    for each in points:
        if each.behaviour is not None:
            if each.point.scale_from is not None:
                reason = f"a point that {each.point.scale_from} scales does not move"
                raise WrongValue.about(each.moved_by, reason)
            with inside(*each.moved_by):
                clockwork.start(each)


def _check_names(found: list[SimulatedPoint], points: Mapping[str, Point]) -> None:
    names = set(points)
    for each in found:
        name = each.point.name
        if each.is_named and name in names:
            raise WrongValue.about((*each.path, "name"), f"there is already a point {name}")
        if each.is_named:
            names.add(name)


def _check_scales(found: list[SimulatedPoint], points: Mapping[str, Point]) -> None:
    paths = {each.point.name: each.path for each in found if each.table in TABLES}
    own = {each.point.name: each.point for each in found if each.table in TABLES}
    for name, mistake in scale_mistakes({**points, **own}):
        raise mistake.renamed(paths[name])


def _mapping(points: list[SimulatedPoint], budget: Budget) -> Tables:
    places: dict[str, list[range]] = {table: [] for table in TABLES}
    for each in points:
        places[each.table].append(range(each.first, each.stop))
    mapping = Tables(**places)
    for each in points:
        if any(each.cells):  # new tables contain zeros, which take no memory
            budget.spend(each.path, each.stop - each.first)
            getattr(mapping, each.table)[each.first : each.stop] = each.all_cells
    return mapping


def _files(points: list[SimulatedPoint], budget: Budget) -> Iterator[tuple[int, RecordFile]]:
    """Yield the files one by one, because records need more memory while they are built."""
    in_order = sorted(points, key=lambda each: (each.file, each.first))
    for number, parts in groupby(in_order, key=lambda each: each.file):
        records: dict[int, int] = {}
        before = 0
        for each in parts:
            budget.spend(each.path, each.stop - before)
            before = each.stop
            records.update(enumerate(each.all_cells, start=each.first))
        yield number, RecordFile(records)


def _fifos(where: Path, unit: Mapping[str, Any]) -> dict[int, list[int]]:
    fifos: dict[int, list[int]] = {}
    for at, raw in enumerate(unit.get("fifo", ())):
        path = (*where, at)
        given = FIFO.read(path, raw)
        address, values = given["address"], given["values"]
        if address in fifos:
            reason = f"there is already a queue at address {address}"
            raise WrongValue.about((*path, "address"), reason)
        if len(values) > 31:
            raise WrongValue((*path, "values"), f"must be 0..31, not {len(values)}")
        numbers = enumerate(values)
        fifos[address] = [integer((*path, "values", i), value, 0, 0xFFFF) for i, value in numbers]
    return fifos


def _identification(path: Path, unit: Mapping[str, Any]) -> dict[str | int, str | bytes]:
    objects: dict[str | int, str | bytes] = {}
    check = bytes_or_text(0, 244)
    for key, value in unit.get("identification", {}).items():
        place = (*path, shown_key(key))
        number = _object_id(place, key)
        if number in objects:
            raise WrongValue.about(place, f"there is already an object {number}")
        objects[number] = check(place, value)
    return objects


def _object_id(path: Path, key: str) -> int:
    numbers = {name: number for number, name in OBJECT_NAMES.items()}
    number = numbers.get(key, int(key) if key.isdecimal() and len(key) < 4 else -1)
    if number not in OBJECT_NAMES and not 0x80 <= number <= 0xFF:
        names = ", ".join(numbers)
        reason = f"no such key; allowed are {names}, and the numbers 0..6, 128..255"
        raise WrongValue.about(path, reason + close_to(key, numbers))
    return number
