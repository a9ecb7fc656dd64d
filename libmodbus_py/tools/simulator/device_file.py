"""
Device files: whole simulated devices, written in TOML.

``docs/how-to/simulator.md`` explains every key, and the example plant
(``libmodbus-py serve --example plant``) has each once.

Addresses outside all ranges do not exist: accesses to them get exception 2, and so do accesses that
a range does not allow.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from itertools import groupby
from os import PathLike, fspath
from os.path import dirname
from typing import Any

from ...device.functions import DEFAULT_SERVER_ID, RecordFile
from ...device.mapping import Mapping as Tables
from ...maps.point import Point
from ...maps.point_plan import scale_mistakes
from ...protocol.checks import integer
from ...protocol.mistakes import Path, WrongValue, close_to, inside, placed
from ...protocol.pdu.interface import OBJECT_NAMES
from ...protocol.tables import TABLES
from ..faults.fault import Fault
from ..files.schema import bytes_or_text
from ..files.texts import FileError, load_file, read_toml, shown_key
from .clockwork import Clockwork, SimulatedPoint
from .keys import FAULT, FIFO, FILE, UNIT
from .points import (
    Maps,
    check_overlaps,
    checked_defaults,
    mapped_contents,
    mapped_points,
    own_points,
    without_parts,
)
from .simulated import SimulatedDevice, Simulation

__all__ = [
    "DeviceFileError",
    "SimulatedDevice",
    "Simulation",
    "load",
    "mapped_simulation",
    "parse",
]

Clock = Callable[[], float]


class DeviceFileError(FileError):
    """
    A device file is wrong; the message names file, line and key, and what is allowed.

    Attributes:
        files: the paths of the register maps that were read, or could not be read.
    """

    files: tuple[str, ...] = ()


def load(path: str | PathLike[str], *, clock: Clock = time.monotonic) -> Simulation:
    """
    Return the simulation that a device file describes. Its values begin to move at once.

    Args:
        path: path of the file; paths of register maps in the file are relative to its folder.
        clock: returns the time in seconds.

    Raises:
        DeviceFileError: the file cannot be read, is not TOML, or contains a mistake.
    """
    maps = Maps(dirname(fspath(path)))
    try:
        return load_file(path, partial(_parse, maps=maps, clock=clock), DeviceFileError)
    except DeviceFileError as error:
        error.files = maps.files
        raise


def parse(
    text: str, *, clock: Clock = time.monotonic, folder: str | PathLike[str] = ""
) -> Simulation:
    """
    Return the simulation that the text of a device file describes.

    Args:
        clock: returns the time in seconds.
        folder: the folder to which paths of register maps are relative.

    Raises:
        DeviceFileError: the text is not TOML, or contains a mistake.
    """
    try:
        return _parse(text, maps=Maps(fspath(folder)), clock=clock)
    except (TypeError, ValueError) as error:
        raise DeviceFileError.of(error) from None


def mapped_simulation(
    map: str, units: Iterable[int] = (), columns: Mapping[str, str] | None = None
) -> Simulation:
    """
    Return a simulation of devices that have the points of a register map, all zero.

    Args:
        map: path of the map, or the name of one that comes with the package.
        units: the units, 0..247 or 255; empty for one device that answers every unit.
        columns: as for `load_map`.

    Raises:
        DeviceFileError: the map cannot be read or contains a mistake, or a unit is wrong.
    """
    described = [{"id": unit, "map": map} for unit in units] or [{"map": map}]
    try:
        return _simulation({"unit": described}, maps=Maps("", columns), clock=time.monotonic)
    except (TypeError, ValueError) as error:
        mistake = placed(error, ())
        # There is no file whose keys the path could name.
        path = "units" if mistake.path[2:3] == ("id",) else ()
        raise DeviceFileError(path, mistake.reason) from None


def _parse(text: str, *, maps: Maps, clock: Clock) -> Simulation:
    return _simulation(read_toml(text), maps=maps, clock=clock)


def _simulation(content: dict[str, Any], *, maps: Maps, clock: Clock) -> Simulation:
    given = FILE.read((), content)
    defaults = checked_defaults((), given)
    faults: dict[int | None, list[Fault]] = {None: _faults((), given)}
    devices: dict[int | None, SimulatedDevice] = {}
    of_all = {"roles": given["roles"]} if "roles" in given else {}
    for at, own in enumerate(given["unit"]):
        path = ("unit", at)
        if "id" not in own and len(given["unit"]) > 1:
            raise WrongValue((*path, "id"), "is missing; only a single unit can be without")
        unit = UNIT.read(path, of_all | own)
        # Compared after the file was read again, together with what it takes from elsewhere.
        definition = own, content.get("roles")
        device = _device(path, unit, definition, defaults, maps, clock)
        number = unit.get("id")
        if number in devices:
            raise WrongValue.about((*path, "id"), f"there is already a unit {number}")
        devices[number] = device
        faults[number] = faults.get(number, []) + _faults(path, unit)
    if not devices:
        raise WrongValue("unit", "must not be empty")
    return Simulation(devices, {unit: each for unit, each in faults.items() if each}, maps.files)


def _faults(path: Path, given: Mapping[str, Any]) -> list[Fault]:
    raw = given.get("fault", ())
    return [FAULT.read((*path, "fault", at), each) for at, each in enumerate(raw)]


# --- one unit --------------------------------------------------------------------------------


def _device(
    path: Path,
    unit: dict[str, Any],
    definition: object,
    defaults: dict[str, Any],
    maps: Maps,
    clock: Clock,
) -> SimulatedDevice:
    """Return the device of a unit, whose keys are checked."""
    defaults = defaults | checked_defaults(path, unit)
    named = own_points(path, unit, defaults)
    contents, parts = without_parts(named)
    check_overlaps(contents)
    of_maps = mapped_points(unit, maps)
    contents += mapped_contents(path, unit, of_maps)
    check_overlaps(contents)
    _check_names(named, of_maps)
    in_tables = [each for each in contents if each.table in TABLES]
    mapping = _mapping(in_tables)
    clockwork = Clockwork(mapping, in_tables, clock)
    _start(clockwork, in_tables)
    device = SimulatedDevice(
        mapping,
        name=unit.get("name", ""),
        description=unit.get("description", ""),
        definition=(definition, defaults, of_maps),
        contents=contents,
        mapped=of_maps | parts,
        clockwork=clockwork,
        fifos=_fifos((*path, "fifo"), unit),
        identification=_identification((*path, "identification"), unit),
        server_id=DEFAULT_SERVER_ID._replace(**unit.get("server_id", {})),
        exception_status=unit.get("exception_status", 0),
        authorize=unit.get("roles"),
    )
    device.files.update(_files([each for each in contents if each.file]))
    return device


def _check_names(own: list[SimulatedPoint], of_maps: Mapping[str, Point]) -> None:
    names = set(of_maps)
    for each in own:
        if each.is_named and each.point.name in names:
            reason = f"there is already a point {each.point.name}"
            raise WrongValue.about((*each.path, "name"), reason)
        if each.is_named:
            names.add(each.point.name)
    by_name = {each.point.name: each for each in own if each.table in TABLES}
    points = {name: each.point for name, each in by_name.items()}
    for name, mistake in scale_mistakes({**of_maps, **points}):
        raise mistake.renamed(by_name[name].path)


def _mapping(points: list[SimulatedPoint]) -> Tables:
    ranges: dict[str, list[range]] = {table: [] for table in TABLES}
    for each in points:
        ranges[each.table].append(range(each.first, each.stop))
    mapping = Tables(**ranges)
    for each in points:
        if any(each.cells):  # new tables contain zeros, which take no memory
            getattr(mapping, each.table)[each.first : each.stop] = each.all_cells
    return mapping


def _start(clockwork: Clockwork, points: list[SimulatedPoint]) -> None:
    for each in points:
        if each.behaviour is not None:
            if each.point.scale_from is not None:
                reason = f"a point that {each.point.scale_from} scales does not move"
                raise WrongValue.about(each.moved_by, reason)
            with inside(*each.moved_by):
                clockwork.start(each)


def _files(records: list[SimulatedPoint]) -> Iterator[tuple[int, RecordFile]]:
    in_order = sorted(records, key=lambda each: (each.file, each.first))
    for number, parts in groupby(in_order, key=lambda each: each.file):
        cells = {at: cell for each in parts for at, cell in enumerate(each.all_cells, each.first)}
        yield number, RecordFile(cells)


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
        where = (*path, shown_key(key))
        number = _object_id(where, key)
        if number in objects:
            raise WrongValue.about(where, f"there is already an object {number}")
        objects[number] = check(where, value)
    return objects


def _object_id(path: Path, key: str) -> int:
    numbers = {name: number for number, name in OBJECT_NAMES.items()}
    number = numbers.get(key, int(key) if key.isdecimal() and len(key) < 4 else -1)
    if number not in OBJECT_NAMES and not 0x80 <= number <= 0xFF:
        names = ", ".join(numbers)
        reason = f"no such key; allowed are {names}, and the numbers 0..6, 128..255"
        raise WrongValue.about(path, reason + close_to(key, numbers))
    return number
