"""
Device files: whole simulated devices, written in TOML.

``docs/how-to/simulator.md`` explains every key, and the example plant
(``libmodbus-py serve --example plant``) has each once.

Addresses outside all ranges do not exist: accesses to them get exception 2, and so do accesses that
a range does not allow.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from os import PathLike, fspath
from os.path import dirname
from typing import Any

from ...device.functions import DEFAULT_SERVER_ID
from ...device.mapping import Mapping as Tables
from ...protocol.checks import integer
from ...protocol.mistakes import Path, WrongValue, close_to, inside, placed
from ...protocol.pdu.interface import OBJECT_NAMES
from ...protocol.tables import TABLES, joined
from ...protocol.values import value_type
from ..faults.fault import Fault
from ..files.schema import bytes_or_text
from ..files.texts import FileError, load_file, read_toml, shown_key
from .clockwork import Clockwork, SimulatedPoint
from .keys import DEFAULTS, FAULT, FIFO, FILE, TYPING, UNIT
from .points import Found, Maps, points_of
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
    defaults = _defaults((), given)
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


def _defaults(path: Path, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the checked defaults of points, of the file or of a unit."""
    path = (*path, "defaults")
    found: dict[str, Any] = DEFAULTS.read(path, given.get("defaults", {}))
    options = {key: value for key, value in found.items() if key in TYPING and key != "type"}
    with inside(*path):
        value_type(found.get("type", "string:1"), **options)
    return found


# --- one unit --------------------------------------------------------------------------------


def _device(
    path: Path,
    unit: dict[str, Any],
    definition: tuple[object, ...],
    defaults: dict[str, Any],
    maps: Maps,
    clock: Clock,
) -> SimulatedDevice:
    """Return the device of a unit, whose keys are checked."""
    defaults = defaults | _defaults(path, unit)
    found = points_of(path, unit, defaults, maps)
    mapping, records, contents = _filled(found)
    of_maps = [each.point for each in contents if each.is_mapped]
    return SimulatedDevice(
        mapping,
        name=unit.get("name", ""),
        description=unit.get("description", ""),
        definition=(*definition, defaults, of_maps),
        contents=contents,
        clockwork=Clockwork(mapping, [each for each in contents if not each.file], clock),
        files=records,
        fifos=_fifos((*path, "fifo"), unit),
        identification=_identification((*path, "identification"), unit),
        server_id=DEFAULT_SERVER_ID._replace(**unit.get("server_id", {})),
        exception_status=unit.get("exception_status", 0),
        authorize=unit.get("roles"),
    )


def _filled(
    found: list[Found],
) -> tuple[Tables, dict[int, dict[int, int]], list[SimulatedPoint]]:
    """Return the tables and the records with their first values, and points that know them."""
    spans: dict[str, list[range]] = {table: [] for table in TABLES}
    records: dict[int, dict[int, int]] = {}
    for each, change in found:
        if each.file:
            cells = change.cells if change else [0] * len(each.span)
            records.setdefault(each.file, {}).update(zip(each.span, cells, strict=True))
        else:
            spans[each.table].append(each.span)
    mapping = Tables(**{table: joined(ranges) for table, ranges in spans.items()})
    for each, change in found:
        if change is not None and not each.file:
            table, span = getattr(mapping, each.table), slice(each.span.start, each.span.stop)
            table[span] = change.over(table[span])
    contents = []
    for each, _ in found:
        if each.file:
            first = [records[each.file][record] for record in each.span]
        else:
            first = getattr(mapping, each.table)[each.span.start : each.span.stop]
        contents.append(replace(each, cells=tuple(map(int, first)) if any(first) else ()))
    return mapping, records, contents


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
