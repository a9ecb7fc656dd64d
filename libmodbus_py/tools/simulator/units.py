"""
The units of a device file: of what it says of one, a device.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import groupby
from typing import Any

from ...device.device import DEFAULT_SERVER_ID
from ...device.mapping import Mapping as Tables
from ...device.record_file import RecordFile
from ...maps.point import Point
from ...protocol.checks import integer
from ...protocol.pdu import ServerId
from ...protocol.pdu.interface import OBJECT_NAMES
from ...protocol.tables import TABLES
from ..files.toml_lines import below
from .access_rules import AccessRules
from .checks import DeviceFileError, bytes_or_text, checked, inside
from .clockwork import Clockwork
from .keys import FIFO, RANGES, SERVER_ID, UNIT
from .mapped import Maps, mapped_points, mapped_ranges
from .ranges import Budget, Range, check_overlaps, defaults_of, ranges
from .simulated import SimulatedDevice

__all__ = ["made_unit"]


def made_unit(
    where: str,
    raw: dict[str, object],
    said: object,
    defaults: dict[str, Any],
    maps: Maps,
    clock: Callable[[], float],
    budget: Budget,
) -> tuple[int | None, SimulatedDevice]:
    """
    Make the device of a unit.

    Args:
        where: its path in the file.
        said: what makes it another one than before, besides `defaults` and register maps.
        defaults: of ranges, as the file says them.
        maps: where register maps come from.

    Raises:
        DeviceFileError: it says what cannot be.
    """
    dotted = f"{where}."
    given = checked(dotted, raw, UNIT)
    defaults = defaults | defaults_of(dotted, given)
    found = [each for table in RANGES for each in ranges(dotted, table, given, defaults, budget)]
    check_overlaps(found)
    points = mapped_points(dotted, given, maps, budget)
    if mapped := mapped_ranges(dotted, given, points, budget):
        found += mapped
        check_overlaps(found)
    _check_names(found, points)
    in_tables = [each for each in found if each.run.table in TABLES]
    mapping = _mapping(in_tables, budget)
    clockwork = Clockwork(mapping, [each.run for each in in_tables], clock)
    for each in in_tables:
        with inside(f"{each.where}.{each.behaviour}: "):
            clockwork.start(each.run)
    rules = AccessRules(found, clockwork)
    device = SimulatedDevice(
        mapping,
        name=given.get("name", ""),
        description=given.get("description", ""),
        definition=(said, defaults, points),
        ranges=found,
        mapped=points,
        clockwork=clockwork,
        fifos=_fifos(f"{where}.fifo", given),
        identification=_identification(f"{where}.identification", given),
        server_id=_server_id(f"{where}.server_id.", given),
        exception_status=given.get("exception_status", 0),
        before_write=rules.before_write,
        before_read=rules.before_read,
        authorize=given.get("roles"),
    )
    device.files.update(_files([each for each in found if each.run.table == "file"], budget))
    return given.get("id"), device


def _check_names(found: list[Range], points: Mapping[str, Point]) -> None:
    names = set(points)
    for each in found:
        name = each.told.get("name")
        if name in names:
            raise DeviceFileError(f"{each.where}.name: there is a point {name} before this")
        if name is not None:
            names.add(name)


def _mapping(ranges: list[Range], budget: Budget) -> Tables:
    places: dict[str, list[range]] = {table: [] for table in TABLES}
    for each in ranges:
        places[each.run.table].append(range(each.run.first, each.run.stop))
    mapping = Tables(**places)
    for each in ranges:
        if any(each.cells):  # zeros are there already, and take no memory
            budget.spend(each.where, each.run.stop - each.run.first)
            getattr(mapping, each.run.table)[each.run.first : each.run.stop] = each.all_cells
    return mapping


def _files(ranges: list[Range], budget: Budget) -> Iterator[tuple[int, RecordFile]]:
    """One after the other, for its records take more memory while they are put together."""
    in_order = sorted(ranges, key=lambda each: (each.file, each.run.first))
    for number, parts in groupby(in_order, key=lambda each: each.file):
        records: dict[int, int] = {}
        before = 0
        for each in parts:
            budget.spend(each.where, each.run.stop - before)
            before = each.run.stop
            records.update(enumerate(each.all_cells, start=each.run.first))
        yield number, RecordFile(records)


def _fifos(where: str, unit: Mapping[str, Any]) -> dict[int, list[int]]:
    fifos: dict[int, list[int]] = {}
    for at, raw in enumerate(unit.get("fifo", ())):
        prefix = f"{where}[{at}]."
        given = checked(prefix, raw, FIFO, required=FIFO)
        address, values = given["address"], given["values"]
        if address in fifos:
            raise DeviceFileError(f"{prefix}address: there is a queue at {address} before this")
        if len(values) > 31:
            raise DeviceFileError(f"{prefix}values must be 0..31, not {len(values)}")
        with inside(prefix):
            numbers = enumerate(values)
            fifos[address] = [integer(f"values[{i}]", value, 0, 0xFFFF) for i, value in numbers]
    return fifos


def _identification(where: str, unit: Mapping[str, Any]) -> dict[str | int, str | bytes]:
    objects: dict[str | int, str | bytes] = {}
    check = bytes_or_text(0, 244)
    for key, value in unit.get("identification", {}).items():
        number = _object_id(where, key)
        if number in objects:
            raise DeviceFileError(f"{below(where, key)}: there is an object {number} before this")
        with inside(f"{where}."):
            objects[number] = check(key, value)
    return objects


def _object_id(where: str, key: str) -> int:
    numbers = {name: number for number, name in OBJECT_NAMES.items()}
    number = numbers.get(key, int(key) if key.isdecimal() and len(key) < 4 else -1)
    if number not in OBJECT_NAMES and not 0x80 <= number <= 0xFF:
        names = ", ".join(numbers)
        raise DeviceFileError(
            f"{below(where, key)}: no such key; allowed are {names}, and the numbers 0..6, 128..255"
        )
    return number


def _server_id(where: str, unit: Mapping[str, Any]) -> ServerId:
    given = checked(where, unit.get("server_id", {}), SERVER_ID)
    return DEFAULT_SERVER_ID._replace(**given)
