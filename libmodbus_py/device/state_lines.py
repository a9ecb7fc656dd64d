"""
Values of devices as lines of JSON in a file, and back, so that they survive a restart.

::

    {"libmodbus-py": "state", "version": 1}
    {"unit": 1, "points": {"setpoint": ["holding_registers", 0, 1, "uint16", "ABCD"]}}
    {"unit": 1, "table": "holding_registers", "address": 0, "values": [215]}
    {"unit": 1, "table": "file", "file": 4, "address": 7, "values": [1711, 1214]}
    {"end": 4}

Values that are as at first are left out. The points are those that have one of the values, so that
they are not taken for values of another device. The last line counts those before it: half a file
is not taken for a whole one.
"""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Iterator
from collections.abc import Mapping as MappingABC
from typing import Any, NamedTuple, Protocol

from ..protocol.checks import integer, shown
from ..protocol.json_text import JSON, each_once
from ..protocol.mistakes import Path, WrongType, WrongValue
from ..protocol.tables import TABLE_SIZE, TABLES

__all__ = ["FILE", "Run", "UnitValues", "ValueHolder", "parsed", "read_text", "text_of"]

KIND, VERSION = "state", 1

# Bytes of a file; all units with all their cells need less.
MOST_BYTES = 1 << 29

# Values in one line: people find a mistake in it.
MOST_VALUES = 200

FILE = "file"
"""The table of records of files."""


class Run(NamedTuple):
    """Consecutive cells of a table, or records of a file, and their values."""

    table: str
    file: int
    address: int
    values: list[int]


class UnitValues(NamedTuple):
    """
    The values of one unit.

    Attributes:
        points: what the cells of its named values mean, by name.
        runs: the values.
    """

    points: MappingABC[str, list[Any]]
    runs: list[Run]


class ValueHolder(Protocol):
    """A device, or a mapping alone, that takes values."""

    def has(self, run: Run) -> bool:
        """Return True if all cells of a run exist."""
        ...

    def meaning(self, name: str) -> list[Any] | None:
        """Return what the cells of a point mean; None if there is no such point."""
        ...


Holders = MappingABC[int | None, ValueHolder]

# A table or "file", the number of the file, and the first address that may come next.
Place = tuple[int | None, str, int]


# --- to text ----------------------------------------------------------------------------------


def text_of(units: MappingABC[int | None, UnitValues]) -> str:
    """Return the text of a file, by unit; None is a device that answers every unit."""
    lines: list[dict[str, Any]] = [{"libmodbus-py": KIND, "version": VERSION}]
    for unit, values in units.items():
        lines += _lines_of(unit, values)
    lines.append({"end": len(lines)})
    return "".join(f"{JSON.encode(line)}\n" for line in lines)


def _lines_of(unit: int | None, given: UnitValues) -> Iterator[dict[str, Any]]:
    if given.points:
        yield {"unit": unit, "points": given.points}
    for table, file, address, values in given.runs:
        for at in range(0, len(values), MOST_VALUES):
            place = {"file": file} if table == FILE else {}
            part = values[at : at + MOST_VALUES]
            yield {"unit": unit, "table": table, **place, "address": address + at, "values": part}


# --- from text --------------------------------------------------------------------------------


def parsed(file: str, text: str, units: Holders) -> list[tuple[int | None, Run]]:
    """
    Return the values of a file by unit; all of them fit the devices.

    Args:
        file: its name, for messages.

    Raises:
        ValueError: the text is damaged, of a newer version or of another device; the message
            names the file, the line and the key.
    """
    found: list[tuple[int | None, Run]] = []
    number = 1
    lines = text.split("\n")
    try:
        _check_head(_object(lines[0]))
        reader = _LineReader(units)
        for line in lines[1:-2]:
            number += 1
            found += reader.read(_object(line))
        number = len(lines) if lines[-1] else len(lines) - 1
        _check_end(_object(lines[-2]) if len(lines) > 2 else {}, len(lines) - 2)
        if lines[-1]:
            raise WrongValue((), "nothing may follow the line with the end")
    except (TypeError, ValueError) as error:
        raise ValueError(f"{file}, line {number}: {error}") from None
    return found


def read_text(path: str | os.PathLike[str]) -> str:
    """
    Return the text of a file.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is not a regular file, too long, or not UTF-8; the message names the line.
    """
    with open(path, "rb", opener=_at_once) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise ValueError(f"{os.fspath(path)}: not a regular file")
        data = file.read(MOST_BYTES + 1)
    if len(data) > MOST_BYTES:
        raise ValueError(f"{os.fspath(path)}: more than {MOST_BYTES} bytes")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ValueError(f"{os.fspath(path)}, line {line}: not UTF-8") from None


def _at_once(path: str, flags: int) -> int:
    """Open a named pipe without waiting for a writer."""
    return os.open(path, flags | os.O_NONBLOCK)


def _object(line: str) -> dict[str, Any]:
    try:
        found = json.loads(line, object_pairs_hook=each_once)
    except WrongValue:
        raise
    except ValueError as error:
        column = getattr(error, "colno", 1)
        raise WrongValue((), f"column {column}: not JSON: {getattr(error, 'msg', error)}") from None
    except RecursionError:
        raise WrongValue((), "not JSON: too deep") from None
    if not isinstance(found, dict):
        raise WrongValue((), f"must be an object, not {shown(found)}")
    return found


def _check_head(head: dict[str, Any]) -> None:
    if head.get("libmodbus-py") != KIND:
        raise WrongValue("libmodbus-py", f'must be "{KIND}": this is not a file of values')
    version = integer("version", head.get("version"), 1, 1 << 31)
    if version > VERSION:
        reason = f"must be {VERSION}, not {version}: the file was written by a newer libmodbus-py"
        raise WrongValue("version", reason)


def _check_end(end: dict[str, Any], lines: int) -> None:
    if "end" not in end:
        raise WrongValue("end", "is missing: the file is cut off")
    if end != {"end": lines}:
        raise WrongValue(
            "end", f"must be {lines}, the number of lines before it: lines are missing"
        )


class _LineReader:
    """Reads the lines about units, and checks them against the devices."""

    def __init__(self, units: Holders) -> None:
        self._units = units
        # The first address that may come next, because no cell has two values.
        self._next: dict[Place, int] = {}

    def read(self, line: dict[str, Any]) -> Iterator[tuple[int | None, Run]]:
        is_points = "points" in line
        _check_keys(line, is_points=is_points)
        unit = line["unit"]
        is_unit = unit is None or type(unit) is int
        if not is_unit or unit not in self._units:
            raise WrongValue("unit", f"must be that of a device that is served, not {shown(unit)}")
        if is_points:
            _check_points(line["points"], self._units[unit])
        else:
            yield unit, self._run(unit, line)

    def _run(self, unit: int | None, line: dict[str, Any]) -> Run:
        table, values = line["table"], line["values"]
        if not isinstance(table, str) or (table != FILE and table not in TABLES):
            raise WrongValue("table", f"must be one of {', '.join([*TABLES, FILE])}")
        if not isinstance(values, list) or not values:
            raise WrongType("values", "must be a list that is not empty")
        most = 1 if table in TABLES and TABLES[table].is_bits else 0xFFFF
        for at, value in enumerate(values):
            integer(("values", at), value, 0, most)
        address = integer("address", line["address"], 0, TABLE_SIZE - 1)
        run = Run(table, integer("file", line.get("file", 0), 0, 0xFFFF), address, values)
        if not self._units[unit].has(run):
            name = f"file {run.file}" if table == FILE else table
            reason = f"the device lacks {name} {address}..{address + len(values) - 1}"
            raise WrongValue.about(("address",), reason)
        self._check_order(unit, run)
        return run

    def _check_order(self, unit: int | None, run: Run) -> None:
        place = unit, run.table, run.file
        if run.address < self._next.get(place, 0):
            reason = (
                f"must be {self._next[place]} or more, after the lines before, not {run.address}"
            )
            raise WrongValue("address", reason)
        self._next[place] = run.address + len(run.values)


def _check_keys(line: dict[str, Any], *, is_points: bool) -> None:
    keys = ["unit", "points"] if is_points else ["unit", "table", "address", "values"]
    if line.get("table") == FILE:
        keys.append("file")
    for key in keys:
        if key not in line:
            raise WrongValue(key, "is missing")
    for key in line:
        if key not in keys:
            raise WrongValue.about((key,), "no such key")


def _check_points(found: object, holder: ValueHolder) -> None:
    if not isinstance(found, dict):
        raise WrongType("points", "must be an object")
    for name, meaning in found.items():
        path: Path = ("points", name)
        known = holder.meaning(name)
        if known is None:
            raise WrongValue.about(path, "the device has no such point")
        if meaning != known:
            raise WrongValue(
                path, f"must be {shown(known)}, as in the device, not {shown(meaning)}"
            )
