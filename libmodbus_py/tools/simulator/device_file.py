"""
Device files: whole simulated devices, written in TOML.

``docs/how-to/simulator.md`` explains every key, and the example plant
(``libmodbus-py serve --example plant``) has each once.

Addresses outside all ranges do not exist: accesses to them get exception 2, and so do accesses that
a range does not allow.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from os import PathLike, fspath
from os.path import dirname
from typing import Any

from ...device.functions import DEFAULT_SERVER_ID
from ...device.mapping import Mapping as Tables
from ...files.schema import (
    REQUIRED,
    Check,
    Key,
    Keys,
    a_list,
    bytes_or_text,
    flag,
    keys_of,
    table,
    tables,
    text,
    whole,
)
from ...files.texts import FileError, load_file, read_toml, shown_key
from ...maps.list_words import LIST, ListOptions
from ...protocol.checks import integer
from ...protocol.mistakes import Path, WrongValue, close_to, placed
from ...protocol.pdu.interface import OBJECT_NAMES
from ...protocol.tables import TABLES, joined
from ..faults.fault import LONGEST, Fault
from ..files.rights import roles
from .movements import Movements
from .points import CONTENTS, DEFAULTS, Maps, points_of
from .simulated import SimulatedDevice, Simulation

__all__ = ["DeviceFileError", "SimulatedDevice", "Simulation", "load", "mapped_simulation", "parse"]

Clock = Callable[[], float]


def _unit_id(path: Path, value: object) -> int:
    number = integer(path, value, 0, 255)
    if 247 < number < 255:
        raise WrongValue(path, f"must be in 0..247, or 255, not {number}")
    return number


def _maps(path: Path, value: object) -> list[tuple[Path, str]]:
    """Check one path of a register map, or several; return each with its own place."""
    names = [((*path, at), name) for at, name in enumerate(value)] if type(value) is list else []
    for where, name in names or [(path, value)]:
        if not isinstance(name, str):
            raise WrongValue(where, "must be the path of a register map, or a list of them")
    return names or [(path, str(value))]


def _each(keys: Keys) -> Check:
    """Return a check for an array of tables that have these keys."""

    def check(path: Path, value: object) -> list[Any]:
        return [keys.read((*path, at), raw) for at, raw in enumerate(tables(path, value))]

    return check


def _registers(path: Path, value: object) -> list[int]:
    items = enumerate(a_list(path, value))
    numbers = [integer((*path, at), item, 0, 0xFFFF) for at, item in items]
    if len(numbers) > MOST_QUEUED:
        raise WrongValue(path, f"must have 0..{MOST_QUEUED} registers, not {len(numbers)}")
    return numbers


def _identification(path: Path, value: object) -> dict[int, bytes]:
    numbers = {name: number for number, name in OBJECT_NAMES.items()}
    objects: dict[int, bytes] = {}
    for key, content in table(path, value).items():
        where = (*path, shown_key(key))
        number = numbers.get(key, int(key) if key.isdecimal() and len(key) < 4 else -1)
        if number not in OBJECT_NAMES and not 0x80 <= number <= 0xFF:
            names = ", ".join(numbers)
            reason = f"no such key; allowed are {names}, and the numbers 0..6, 128..255"
            raise WrongValue.about(where, reason + close_to(key, numbers))
        objects[number] = bytes_or_text(0, 244)(where, content)
    return objects


MOST_QUEUED = 31
"""Registers in a queue (application protocol, 6.18)."""

FAULT = keys_of(Fault, data=bytes_or_text(0, LONGEST))

SERVER_ID = Keys(
    [
        Key("identifier", bytes_or_text(1, 125), "the identifier of the device"),
        Key("running", flag, "the run indicator"),
        Key("additional", bytes_or_text(0, 125), "additional data"),
    ]
)

FIFO = Keys(
    [
        Key("address", whole(0, 0xFFFF), "the address of the queue", REQUIRED),
        Key("values", _registers, "oldest first", REQUIRED),
    ]
)

UNIT = Keys(
    [
        Key("id", _unit_id, "0..247 or 255; a single unit without an id answers for every unit"),
        Key("name", text, "a name, for people"),
        Key("description", text, "a description, for people"),
        Key("exception_status", whole(0, 255), "the response to function 7"),
        Key("server_id", SERVER_ID.read, "the response to function 17"),
        Key("identification", _identification, "the response to function 43/14"),
        Key("defaults", DEFAULTS.read, "keys of points of the unit without their own"),
        Key("map", _maps, "paths of register maps; the device has all their points"),
        Key("columns", table, "headings of the maps that are not recognised, by their meaning"),
        Key("list", LIST.read, "what a list does not say of itself, as for load_map"),
        Key("values", table, "initial values of points of the maps, by name"),
        Key("moves", table, "how points of the maps change, by name"),
        *(Key(name, tables, "a table for each point, or run of records") for name in CONTENTS),
        Key("fifo", _each(FIFO), "a table for each queue"),
        Key("fault", _each(FAULT), "a table for each fault"),
        Key("roles", roles, "what each role may read and write, in this unit"),
    ]
)

FILE = Keys(
    [
        Key("unit", tables, "a table for each unit", REQUIRED),
        Key("fault", _each(FAULT), "a table for each fault of all units"),
        Key("roles", roles, "what each role may read and write: [roles.NAME]"),
        Key("defaults", DEFAULTS.read, "keys of points of all units without their own"),
    ]
)


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
        return load_file(
            path, lambda text: _simulation(read_toml(text), maps, clock), DeviceFileError
        )
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
        return _simulation(read_toml(text), Maps(fspath(folder)), clock)
    except (TypeError, ValueError) as error:
        raise DeviceFileError.of(error) from None


def mapped_simulation(
    map: str, units: Iterable[int] = (), options: ListOptions | None = None
) -> Simulation:
    """
    Return a simulation of devices that have the points of a register map, all zero.

    Args:
        map: path of the map, or the name of one that comes with the package.
        units: the units, 0..247 or 255; empty for one device that answers every unit.
        options: how a list is read.

    Raises:
        DeviceFileError: the map cannot be read or contains a mistake, or a unit is wrong.
    """
    tables = [{"id": unit, "map": map} for unit in units] or [{"map": map}]
    try:
        return _simulation({"unit": tables}, Maps("", options), time.monotonic)
    except (TypeError, ValueError) as error:
        mistake = placed(error, ())
        # There is no file whose keys the path could name.
        path = "units" if mistake.path[2:3] == ("id",) else ()
        raise DeviceFileError(path, mistake.reason) from None


def _simulation(content: dict[str, Any], maps: Maps, clock: Clock) -> Simulation:
    file = FILE.read((), content)
    faults: dict[int | None, list[Fault]] = {None: file.get("fault", [])}
    devices: dict[int | None, SimulatedDevice] = {}
    of_all = {"roles": file["roles"]} if "roles" in file else {}
    for at, own in enumerate(file["unit"]):
        path = ("unit", at)
        if "id" not in own and len(file["unit"]) > 1:
            raise WrongValue((*path, "id"), "is missing; only a single unit can be without")
        unit = UNIT.read(path, of_all | own)
        unit["defaults"] = file.get("defaults", {}) | unit.get("defaults", {})
        # Compared after the file was read again, together with what it takes from elsewhere.
        definition = own, content.get("roles"), unit["defaults"]
        number = unit.get("id")
        if number in devices:
            raise WrongValue.about((*path, "id"), f"there is already a unit {number}")
        devices[number] = _device(path, unit, definition, maps, clock)
        faults[number] = faults.get(number, []) + unit.get("fault", [])
    if not devices:
        raise WrongValue("unit", "must not be empty")
    return Simulation(devices, {unit: fault for unit, fault in faults.items() if fault}, maps.files)


def _device(
    path: Path, unit: dict[str, Any], definition: tuple[object, ...], maps: Maps, clock: Clock
) -> SimulatedDevice:
    points = points_of(path, unit, maps)
    in_tables = [point for point in points if not point.file]
    spans = {table: [point.span for point in points if point.table == table] for table in TABLES}
    mapping = Tables(**{table: joined(span) for table, span in spans.items()})
    records: dict[int, dict[int, int]] = {point.file: {} for point in points if point.file}
    for point in points:
        if point.file:
            records[point.file].update(dict.fromkeys(point.span, 0))
    fifos: dict[int, list[int]] = {}
    for at, queue in enumerate(unit.get("fifo", ())):
        if queue["address"] in fifos:
            reason = f"there is already a queue at address {queue['address']}"
            raise WrongValue.about((*path, "fifo", at, "address"), reason)
        fifos[queue["address"]] = queue["values"]
    device = SimulatedDevice(
        mapping,
        name=unit.get("name", ""),
        description=unit.get("description", ""),
        definition=(*definition, [point.point for point in points if point.is_mapped]),
        contents=points,
        movements=Movements(mapping, in_tables, clock),
        files=records,
        fifos=fifos,
        identification=unit.get("identification"),
        server_id=DEFAULT_SERVER_ID._replace(**unit.get("server_id", {})),
        exception_status=unit.get("exception_status", 0),
        authorize=unit.get("roles"),
    )
    device.set_first_values()
    return device
