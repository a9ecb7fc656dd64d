"""
The actions of the command map: check maps, make a class of one, or a map of a device.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path, PurePath
from typing import Any

from ...client.blocking import Context
from ...maps.holes import Holes, carried_out, reading
from ...maps.point import Point
from ...maps.point_plan import PointPlan
from ...maps.register_map import RegisterMap
from ...ports.endpoint import parse
from ...ports.schemes import CLIENT_OPTIONS, SECURITY_OPTIONS, SERIAL_OPTIONS
from ...protocol.errors import ExceptionResponse, ModbusError
from ...protocol.tables import TABLES
from ...tools.files.map_contents import Contents, remarks
from ...tools.files.map_file import contents_of, load_map
from ...tools.files.map_texts import MARK, class_text, csv_text, toml_text
from ...tools.scan.search import Extent, search
from ...tools.simulator.example_files import map_file
from .. import arguments
from ..connecting import connected, endpoint_of
from ..failing import CommandError
from ..main import INTERRUPTED
from ..output import PROGRAM, complain, counted
from ..screen import Status, missing, progress

__all__ = ["check", "class_of", "from_device", "from_sunspec"]

OF_DEVICES = (*CLIENT_OPTIONS, *SERIAL_OPTIONS, *SECURITY_OPTIONS)
"""Options that mean nothing without a device."""

MOST_MISTAKES = 20
"""Mistakes in a file that are printed, at most."""

# With more cells the file would be too long, so points are ranges instead.
MOST_CELLS = 4000

PREFIXES = {
    "coils": "coil",
    "discrete_inputs": "discrete",
    "holding_registers": "holding",
    "input_registers": "input",
}
"""Table -> the first part of the names of its points."""

TEXTS: dict[str, Callable[[Iterable[Point]], str]] = {".toml": toml_text, ".csv": csv_text}


def check(options: argparse.Namespace) -> int:
    """
    Print what each file contains, or its mistakes on stderr, and what a device lacks of it; return
    2 after a mistake, 1 if the device lacks something.

    Raises:
        ValueError: an option of requests without a device.
    """
    columns = dict(options.columns)
    if options.device is None:
        if typed := arguments.given(options, OF_DEVICES):
            raise ValueError(f"{arguments.flag(next(iter(typed)))} needs --device")
        return max([_check_file(file, columns) for file in options.files])
    options.url = options.device
    with closing(connected(options)) as context:
        return max([_check_file(file, columns, context) for file in options.files])


def _check_file(file: str, columns: dict[str, str], context: Context | None = None) -> int:
    try:
        contents = contents_of(map_file(file), MOST_MISTAKES, columns)
    except ValueError as error:
        return _wrong([str(error)])
    if contents.mistakes:
        more = ["and possibly more"] * (len(contents.mistakes) == MOST_MISTAKES)
        return _wrong([*(str(each) for each in contents.mistakes), *more])
    print(f"{file}: {counted(len(contents.points), 'point')}")
    for line in [*_tables(contents), *remarks(contents)]:
        print(f"  {line}")
    return 0 if context is None else _check_device(RegisterMap(contents.points.values()), context)


def _check_device(points: RegisterMap, context: Context) -> int:
    """Print the points that a device refuses; return 1 if there are any."""
    plan = points.plan()
    values, requests = _read(plan, context)
    failed = {name: value for name, value in values.items() if isinstance(value, ModbusError)}
    device = f"{context.url}, unit {context.unit}"
    if failed and len(failed) == len(values):
        error = next(iter(failed.values()))
        complain(f"{device}: all {counted(len(values), 'point')} refused: {error}")
        return 1
    read = f"{len(values) - len(failed)} of {counted(len(values), 'point')} can be read"
    print(f"  {device}: {read}, in {counted(requests, 'request')}")
    sys.stdout.flush()
    for name, error in failed.items():
        complain(f"{name} cannot be read: {error}")
    return 1 if failed else 0


def _read(plan: PointPlan, context: Context) -> tuple[dict[str, Any], int]:
    """Return all values, or their errors, and how many requests read those without an error."""

    def ask(requests: list[Any]) -> list[Any]:
        outcomes = context.execute_many(requests, max_in_flight=1, return_exceptions=True)
        for each in outcomes:
            if isinstance(each, ModbusError) and not isinstance(each, ExceptionResponse):
                raise each
        return outcomes

    context.connect()
    holes = Holes()
    facts = plan.blocks, holes, context.now(), context.statistics.connects
    answers = carried_out(reading(*facts), ask)
    return plan.results(answers, return_exceptions=True), len(next(reading(*facts), []))


def _wrong(lines: list[str]) -> int:
    for line in lines:
        complain(line)
    return 2


def _tables(contents: Contents) -> list[str]:
    """Return a line for each table that has points, followed by its requests."""
    plan = RegisterMap(contents.points.values()).plan()
    lines = []
    for table, rules in TABLES.items():
        points = [point for point in contents.points.values() if point.table == table]
        if points:
            written = sum(point.is_writable for point in points)
            what = f", {written} of them can be written" if written else ""
            lines.append(f"{table}: {counted(len(points), 'point')}{what}")
        function = rules.read(0, 1).function
        asked: list[Any] = [each for each in plan.requests if each.function == function]
        lines += [f"  read {each.address} {each.count}" for each in asked]
    return lines


def class_of(options: argparse.Namespace) -> int:
    """Write a class for a register map to a file, or print it."""
    map = load_map(map_file(options.file), columns=dict(options.columns))
    text = class_text(map, PurePath(options.file).stem)
    if options.output is None:
        print(text, end="", flush=True)
        return 0
    _check_output(options.output)
    Path(options.output).write_text(text, encoding="utf-8")
    print(f"{options.output}: {counted(len(map), 'point')}", file=sys.stderr)
    return 0


def _check_output(output: str) -> None:
    """Refuse to overwrite a file that this command has not written."""
    path = Path(output)
    if path.suffix != ".py":
        raise ValueError(f"{output}: it must end with .py")
    if not path.absolute().parent.is_dir():
        raise ValueError(f"{output}: the folder does not exist")
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            start = file.read(2000)
    except FileNotFoundError:
        return
    if MARK not in start:
        raise ValueError(f"{output} exists, and would be overwritten")


# --- maps of devices -----------------------------------------------------------------


def from_device(options: argparse.Namespace) -> int:
    """Find what a device has, and write a map of it."""
    text_of = _form_of(options.output)
    url = endpoint_of(options).url
    status = Status()
    searched = search(url, on_progress=lambda state: status.show(progress(state)))
    code = 0
    try:
        with searched:
            for _ in searched:
                pass
    except KeyboardInterrupt:
        code = INTERRUPTED
    finally:
        status.clear()
    points = _points(searched.extents)
    if not points:
        raise CommandError(f"no table can be read: {_ended(searched.extents)}")
    _write(options.output, "\n".join([*_heading(url, searched.extents), text_of(points)]))
    if options.output is not None:
        what = counted(len(points), "point")
        print(f"{options.output}: {what}; fill in names, types and units", file=sys.stderr)
    return code


def from_sunspec(options: argparse.Namespace) -> int:
    """Find the SunSpec models of a device, and write a map of their points."""
    from ...tools.sunspec.discovery import discover

    text_of = _form_of(options.output)
    with closing(connected(options)) as context:
        try:
            device = discover(context)
        except ImportError as error:
            raise CommandError(str(error)) from None
    for note in device.notes:
        complain(note)
    heading = f"# SunSpec models of {endpoint_of(options)}, found by {PROGRAM} map from-sunspec"
    models = f"# {', '.join(f'{model.id} {model.name}' for model in device)}"
    _write(options.output, "\n".join([heading, models, "", text_of(device.map.values())]))
    if options.output is not None:
        print(f"{options.output}: {counted(len(device.map), 'point')}", file=sys.stderr)
    return 0


def _form_of(output: str | None) -> Callable[[Iterable[Point]], str]:
    """Return the writer of the file; a file that cannot be written is refused before the search."""
    if output is None:
        return toml_text
    text_of = TEXTS.get(PurePath(output).suffix.lower())
    if text_of is None:
        raise ValueError(f"{output}: it must end with one of {', '.join(TEXTS)}")
    if os.path.lexists(output):
        raise ValueError(f"{output} exists, and would be overwritten")
    if not Path(output).absolute().parent.is_dir():
        raise ValueError(f"{output}: the folder does not exist")
    return text_of


def _points(extents: list[Extent]) -> list[Point]:
    """Return a point for each cell, or for each range if there are very many cells."""
    found: list[tuple[Any, range]] = [
        (extent.table, cells) for extent in extents for cells in extent.ranges
    ]
    if sum(len(cells) for _, cells in found) <= MOST_CELLS:
        found = [(table, range(at, at + 1)) for table, cells in found for at in cells]
    return [
        Point(f"{PREFIXES[table]}_{cells.start}", table, cells.start, len(cells), access="read")
        for table, cells in found
    ]


def _heading(url: str, extents: list[Extent]) -> list[str]:
    told = [(extent.table, missing(extent)) for extent in extents]
    return [
        f"# Addresses of {parse(url)} that can be read, found by {PROGRAM} map from-device",
        *(f"# {table}: {text}" for table, text in told if text),
    ]


def _ended(extents: list[Extent]) -> str:
    reasons = dict.fromkeys(extent.ended or "no address can be read" for extent in extents)
    return ", ".join(reasons) or "nothing was asked"


def _write(output: str | None, text: str) -> None:
    """Write a text to a new file, or print it if there is no name."""
    if output is None:
        print(text, end="", flush=True)
        return
    with open(output, "x", encoding="utf-8") as file:
        try:
            file.write(text)
            file.flush()
        except OSError as error:
            os.unlink(output)
            raise OSError(error.errno, error.strerror, output) from None
