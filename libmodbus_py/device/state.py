"""
The values of devices in a file, so that they survive a restart.

The file is one JSON object::

    {"libmodbus-py": "state", "version": 1, "units": {
    "1": {"points": {"setpoint": ["holding_registers", 0, 1, "uint16", "ABCD"]},
          "holding_registers": {"0": [215]}, "files": {"4": {"7": [1711, 1214]}}},
    "2": {"coils": {"5": [1]}}
    }}

The name of a unit is its number, or "every" for a device that answers every unit. ``{"7": [1711,
1214]}`` stands for values from address (or record) 7 on. Only values that differ from the first
values of the device are in the file, so that a new device file may give others new first values.
`points` are those that have one of the values: a file is not taken for that of another device.
"""

from __future__ import annotations

import contextlib
import errno
import glob
import hashlib
import json
import os
import stat
import tempfile
from array import array
from collections.abc import Iterable, Iterator
from collections.abc import Mapping as MappingABC
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, Any, Protocol

from ..protocol.checks import integer, shown
from ..protocol.json_text import JSON, each_once
from ..protocol.mistakes import Path, WrongType, WrongValue, inside
from ..protocol.tables import TABLE_SIZE, TABLES, joined, touches
from ..system import open_file
from .access import Access, TableOrFile, values_at
from .mapping import Mapping
from .records import Files

if TYPE_CHECKING:
    from ..maps.point import Point
    from ..maps.register_map import RegisterMap

KIND, VERSION = "state", 1

EVERY = "every"
"""The name of the unit of a device that answers every unit."""

# The end of the name of a temporary file.
TEMPORARY = ".new"


class StateOwner(Protocol):
    """The part of a `Device`, which imports this, whose values are kept."""

    @property
    def mapping(self) -> Mapping: ...

    @property
    def files(self) -> Files: ...

    @property
    def points(self) -> RegisterMap: ...

    def first_values(self) -> Iterable[Access]: ...


Devices = MappingABC[int | None, StateOwner]
"""Unit -> device; None stands for every unit."""

Cells = dict[TableOrFile, "tuple[int, array[int]]"]
"""The first address of each table and file, and the values from there on."""


# --- the values of a device -------------------------------------------------------------------


def _views(device: StateOwner) -> dict[TableOrFile, tuple[int, memoryview]]:
    tables = {(name, 0): getattr(device.mapping, name) for name in TABLES}
    files = {("file", number): (0, file.view) for number, file in device.files.items()}
    return {place: (table.addresses.start, table.view) for place, table in tables.items()} | files


def fingerprint(device: StateOwner) -> bytes:
    """Return a digest of all values, so that only changed ones are encoded."""
    digest = hashlib.blake2b(digest_size=16, usedforsecurity=False)
    with device.mapping:
        for _, view in _views(device).values():
            digest.update(view)
    return digest.digest()


def _present(device: StateOwner) -> Cells:
    """Return copies of all values. The caller holds the mapping's lock."""
    views = _views(device).items()
    return {place: (start, array(view.format, bytes(view))) for place, (start, view) in views}


def _with_values(device: StateOwner, values: Iterable[Access]) -> Cells:
    """Return the initial values, some of them replaced. The caller holds the mapping's lock."""
    views = _views(device).items()
    cells_of = {place: (at, array(view.format, bytes(view.nbytes))) for place, (at, view) in views}
    for value in (*device.first_values(), *values):
        start, cells = cells_of[value.table, value.file]
        at = value.address - start
        cells[at : at + value.count] = array(cells.typecode, value.values)
    return cells_of


def _differences(present: Cells, others: Cells) -> Iterator[Access]:
    for (table, file), (start, cells) in present.items():
        if cells == others[table, file][1]:  # most are, and to compare each cell takes long
            continue
        pairs = enumerate(zip(cells, others[table, file][1], strict=True))
        places = [at for at, (value, other) in pairs if value != other]
        for _, group in groupby(enumerate(places), lambda item: item[1] - item[0]):
            run = [at for _, at in group]
            values = tuple(cells[run[0] : run[-1] + 1])
            yield Access(table, start + run[0], len(run), values, file)


def _set_values(device: StateOwner, values: Iterable[Access]) -> None:
    """Set these values, and all others to their initial ones."""
    with device.mapping as mapping:
        # Equal cells are not written, because untouched pages of zeros take no memory.
        for run in _differences(_with_values(device, values), _present(device)):
            if run.table == "file":
                device.files[run.file].write(run.address, run.values)
            else:
                getattr(mapping, run.table)[run.address : run.address + run.count] = run.values


# --- to text ----------------------------------------------------------------------------------


def state_text(units: Iterable[str]) -> str:
    """Return the text of a file; `units`: each as of `unit_text`, which may be empty."""
    body = ",\n".join(filter(None, units))
    return f'{{"libmodbus-py": "{KIND}", "version": {VERSION}, "units": {{\n{body}\n}}}}\n'


def unit_text(unit: int | None, device: StateOwner) -> str:
    """Return the part of a unit in the text of a file; empty if it has only first values."""
    with device.mapping:
        present, first = _present(device), _with_values(device, ())
    values = _unit_object(device, _differences(present, first))
    return f'"{EVERY if unit is None else unit}": {JSON.encode(values)}' if values else ""


def _unit_object(device: StateOwner, values: Iterable[Access]) -> dict[str, Any]:
    content: dict[str, Any] = {}
    cells: dict[str, list[range]] = {}
    for value in values:
        cells.setdefault(value.table, []).append(range(value.address, value.address + value.count))
        runs = content.setdefault("files" if value.table == "file" else value.table, {})
        if value.table == "file":
            runs = runs.setdefault(str(value.file), {})
        runs[str(value.address)] = value.values
    ranges_of = {table: joined(ranges) for table, ranges in cells.items()}
    points = {
        name: _meaning(point)
        for name, point in sorted(device.points.items())
        if touches(ranges_of.get(point.table, ()), point.address, len(point.cells))
    }
    return {"points": points, **content} if points else content


def _meaning(point: Point) -> list[Any]:
    """Return what the cells of a point mean, apart from scale, bounds and texts."""
    return [point.table, point.address, point.count, point.type, point.order]


# --- from text --------------------------------------------------------------------------------


def load_state(file: str, text: str, devices: Devices) -> None:
    """Set the values of devices to those of a text; a ValueError names the file and the key."""
    try:
        units = _checked_units(_parsed(text), devices)
    except (TypeError, ValueError) as error:
        reason = str(error)
        reason = reason if reason.isprintable() else ascii(reason)[1:-1]
        raise ValueError(f"{file}: {reason}") from None
    for unit, device in devices.items():
        _set_values(device, units.get(unit, ()))


def _parsed(text: str) -> object:
    try:
        return json.loads(text, object_pairs_hook=each_once)
    except json.JSONDecodeError as error:
        reason = f"line {error.lineno}, column {error.colno}: not JSON: {error.msg}"
        raise WrongValue((), f"{reason} (is the file cut off?)") from None
    except RecursionError:
        raise WrongValue((), "not JSON: too deep") from None


def _checked_units(content: object, devices: Devices) -> dict[int | None, list[Access]]:
    head = _object((), content)
    if head.get("libmodbus-py") != KIND:
        raise WrongValue("libmodbus-py", f'must be "{KIND}": this is not a file of values')
    version = integer("version", head.get("version"), 1, 1 << 31)
    if version > VERSION:
        reason = f"must be {VERSION}, not {version}: the file was written by a newer libmodbus-py"
        raise WrongValue("version", reason)
    _object((), head, ("libmodbus-py", "version", "units"))
    names = {EVERY if unit is None else str(unit): unit for unit in devices}
    units: dict[int | None, list[Access]] = {}
    for name, unit in _object(("units",), head.get("units")).items():
        if name not in names:
            reason = f"no such unit is served, only {', '.join(names) or 'none'}"
            raise WrongValue.about(("units", name), reason)
        with inside("units", name):
            units[names[name]] = list(_checked_unit(unit, devices[names[name]]))
    return units


def _checked_unit(unit: object, device: StateOwner) -> Iterator[Access]:
    keys = _object((), unit, ("points", *TABLES, "files"))
    for name, meaning in _object(("points",), keys.pop("points", {})).items():
        point = device.points.get(name)
        if point is None:
            raise WrongValue.about(("points", name), "the device has no such point")
        if meaning != _meaning(point):
            rule = f"must be {shown(_meaning(point))}, as in the device"
            raise WrongValue(("points", name), f"{rule}, not {shown(meaning)}")
    for number, records in _object(("files",), keys.pop("files", {})).items():
        file = _number(("files", number), number)
        yield from _checked_runs(("files", number), records, ("file", file), device)
    for table, runs in keys.items():
        yield from _checked_runs((table,), runs, (table, 0), device)


def _checked_runs(
    path: Path, items: object, place: TableOrFile, device: StateOwner
) -> list[Access]:
    table, file = place
    most = 1 if table in TABLES and TABLES[table].is_bits else 0xFFFF
    runs = []
    for key, values in _object(path, items).items():
        address = _number((*path, key), key)
        if not isinstance(values, list) or not values:
            raise WrongType((*path, key), "must be a list that is not empty")
        for at, value in enumerate(values):
            integer((*path, key, at), value, 0, most)
        run = Access(table, address, len(values), tuple(values), file)
        if values_at(run, device.mapping, device.files) is None:
            name = f"file {file}" if file else table
            reason = f"the device lacks {name} {address}..{address + run.count - 1}"
            raise WrongValue.about((*path, key), reason)
        runs.append(run)
    runs.sort(key=lambda run: run.address)
    for before, run in pairwise(runs):
        if run.address < before.address + before.count:
            raise WrongValue.about(path, f"{run.address} has two values")
    return runs


def _object(path: Path, content: object, keys: Iterable[str] | None = None) -> dict[str, Any]:
    """Return an object of JSON; if `keys` are passed, other keys are refused."""
    if not isinstance(content, dict):
        raise WrongType(path, f"must be an object, not {shown(content)}")
    for key in content:
        if keys is not None and key not in keys:
            raise WrongValue.about((*path, key), f"no such key; allowed are {', '.join(keys)}")
    return content


def _number(path: Path, key: str) -> int:
    if not (key.isascii() and key.isdecimal() and len(key) <= len(str(TABLE_SIZE))):
        raise WrongValue(path, f"must be a number in 0..{TABLE_SIZE - 1}")
    return integer(path, int(key), 0, TABLE_SIZE - 1)


# --- files ------------------------------------------------------------------------------------


def read_text(path: str | os.PathLike[str]) -> str:
    """Return the text of a file; raise OSError, or ValueError if it is not UTF-8."""
    with open_file(path) as file:
        data = file.read()
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"{os.fspath(path)}: not UTF-8 at byte {error.start}") from None


def replace_file(path: str | os.PathLike[str], text: str) -> None:
    """
    Replace a file atomically: write a temporary file beside it, force it to the disk, rename it.

    A new file is readable by its owner only; one that is replaced keeps its permissions, and a
    symbolic link stays one. If this raises OSError, the file is unchanged.
    """
    target = os.path.realpath(path)
    folder, name = os.path.split(target)
    mode = 0o600
    with contextlib.suppress(FileNotFoundError):
        mode = os.stat(target).st_mode
        if not stat.S_ISREG(mode):  # such as /dev/null
            raise OSError(errno.EINVAL, "not a regular file", os.fspath(path))
    try:
        descriptor, temporary = tempfile.mkstemp(TEMPORARY, f"{name}.", folder)
    except OSError as error:  # which names the temporary file
        raise OSError(error.errno, error.strerror, os.fspath(path)) from None
    try:
        with open(descriptor, "w", encoding="utf-8", newline="") as file:
            os.fchmod(descriptor, stat.S_IMODE(mode))
            file.write(text)
            file.flush()
            os.fsync(descriptor)
        os.replace(temporary, target)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        raise
    folder_descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(folder_descriptor)  # forces the new name to the disk
    finally:
        os.close(folder_descriptor)


def remove_leftovers(path: str | os.PathLike[str]) -> None:
    """Remove the temporary files of a process that was killed. No other may write the file now."""
    for temporary in glob.glob(f"{glob.escape(os.path.realpath(path))}.????????{TEMPORARY}"):
        with contextlib.suppress(OSError):
            os.unlink(temporary)
