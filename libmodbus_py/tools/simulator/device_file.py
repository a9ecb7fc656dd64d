"""
Device files: whole simulated devices, written in TOML.

``docs/how-to/simulator.md`` explains every key, and the example plant
(``libmodbus-py serve --example plant``) has each once. In short::

    [[unit]]                            one or more; without id: any unit
      id, name, description, exception_status
      map                     register maps; all their points exist
      [unit.values], [unit.moves]       what the points are, and how they move, by name
      [unit.defaults]                   what ranges have unless they say something else
      [unit.server_id]                  identifier, running, additional
      [unit.identification]             VendorName = "...", 128 = "..."
      [[unit.coils]]                    ranges, also discrete_inputs, input_registers
      [[unit.holding_registers]]        and holding_registers: address, count, value or
                                        values, type, order, encoding, padding, access;
                                        counter, sine, random_walk or copy;
                                        name, description, unit, scale, offset
      [[unit.file]]                     records of a file: number, record, count, ...
      [[unit.fifo]]                     address, values
      [[unit.fault]]                    as `faults.Fault`
      [unit.roles.NAME]                 who may read and write what, in place of those below
    [[fault]]                           of all units
    [defaults]                          of all units
    [roles.NAME]                        read, write, functions, as `Allow`; "" without a role

Addresses outside all ranges do not exist: accesses to them get exception 2, and so do accesses that
a range does not allow.

A file may have up to 512 KiB, 1000 faults, 10000 named ranges and points of register maps, and
524288 cells. Cells are all records of each file from 0 to its last one, and values in the tables
that are not 0; a value with a scale counts as 16 cells. Loading any file takes no more than a
second, apart from reading register maps.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from os import PathLike, fspath
from os.path import dirname
from typing import Any

from ...protocol.mistakes import Path, WrongValue, placed
from ..faults.fault import Fault
from ..files.file_error import FileError
from ..files.texts import load_file
from ..files.toml_text import read_toml
from .keys import FAULT, FILE
from .mapped import Maps
from .own_points import Budget, checked_defaults
from .simulated import SimulatedDevice, Simulation, simulation
from .units import made_unit

__all__ = [
    "DeviceFileError",
    "SimulatedDevice",
    "Simulation",
    "load",
    "mapped_simulation",
    "parse",
]

# All faults are checked for each request.
MAX_FAULTS = 1000


class DeviceFileError(FileError):
    """
    A device file is wrong; the message names file, line and key, and what is allowed.

    Attributes:
        files: the paths of the register maps that were read, or could not be read.
    """

    files: tuple[str, ...] = ()


def load(path: str | PathLike[str], *, clock: Callable[[], float] = time.monotonic) -> Simulation:
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
    text: str,
    *,
    clock: Callable[[], float] = time.monotonic,
    folder: str | PathLike[str] = "",
) -> Simulation:
    """
    Return the simulation that the text of a device file describes.

    Args:
        folder: the folder to which paths of register maps are relative.

    Raises:
        DeviceFileError: the text is not TOML, or contains a mistake.
    """
    try:
        return _parse(text, maps=Maps(fspath(folder)), clock=clock)
    except (TypeError, ValueError) as error:
        raise DeviceFileError.of(error) from None


def mapped_simulation(map: str, units: Iterable[int] = ()) -> Simulation:
    """
    Return a simulation of devices that have the points of a register map, all zero.

    Args:
        map: path of the map, or the name of one that comes with the package.
        units: the units, 0..247 or 255; empty for one device that answers every unit.

    Raises:
        DeviceFileError: the map cannot be read or contains a mistake, or a unit is wrong.
    """
    described = [{"id": unit, "map": map} for unit in units] or [{"map": map}]
    try:
        return _made({"unit": described}, maps=Maps(""), clock=time.monotonic)
    except (TypeError, ValueError) as error:
        mistake = placed(error, ())
        # There is no file whose keys the path could name.
        path = "units" if mistake.path[2:3] == ("id",) else ()
        raise DeviceFileError(path, mistake.reason) from None


def _parse(text: str, *, maps: Maps, clock: Callable[[], float]) -> Simulation:
    return _made(read_toml(text), maps=maps, clock=clock)


def _made(content: dict[str, Any], *, maps: Maps, clock: Callable[[], float]) -> Simulation:
    given = FILE.read((), content)
    defaults = checked_defaults((), given)
    faults: dict[int | None, list[Fault]] = {None: _faults((), given)}
    devices: dict[int | None, SimulatedDevice] = {}
    budget = Budget()
    of_all = {"roles": given["roles"]} if "roles" in given else {}
    for at, own in enumerate(given["unit"]):
        path, unit = ("unit", at), of_all | own
        if "id" not in unit and len(given["unit"]) > 1:
            raise WrongValue((*path, "id"), "is missing; only a single unit can be without")
        said = own, content.get("roles")
        number, device = made_unit(path, unit, said, defaults, maps, clock, budget)
        if number in devices:
            raise WrongValue.about((*path, "id"), f"there is already a unit {number}")
        devices[number] = device
        faults[number] = faults.get(number, []) + _faults(path, unit)
        if sum(map(len, faults.values())) > MAX_FAULTS:
            reason = f"more than {MAX_FAULTS} faults in one file"
            raise WrongValue.about((*path, "fault"), reason)
    if not devices:
        raise WrongValue("unit", "must hold at least one")
    return simulation(devices, {unit: each for unit, each in faults.items() if each}, maps.files)


def _faults(path: Path, given: Mapping[str, Any]) -> list[Fault]:
    raw = given.get("fault", ())
    return [FAULT.read((*path, "fault", at), each) for at, each in enumerate(raw)]
