"""The actions of the command map: check maps, make a class of one, or a map of a device."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import closing
from pathlib import Path, PurePath
from typing import Any

from ...client.blocking import Client
from ...maps.list_words import ListOptions
from ...maps.lists import MapError
from ...maps.map_file import contents_of, remarks
from ...maps.meaning import NoValue
from ...maps.point import Point
from ...maps.point_plan import borders_of, scale_mistakes
from ...maps.register_map import RegisterMap, load_map
from ...ports.endpoint import parse
from ...protocol.errors import ExceptionResponse, ModbusError
from ...protocol.tables import TABLES
from ...tools.files.map_texts import MARK, class_text, csv_text, toml_text
from ...tools.scan.search import Extent, search
from ...tools.simulator.example_files import map_file
from ..arguments import OF_CLIENTS, endpoint_of, list_keys, new_client, refuse_options
from ..main import INTERRUPTED, CommandError
from ..output import PROGRAM, Status, complain, counted, missing, progress, written_to

MOST_MISTAKES = 20  # mistakes in a file that are printed, at most
MOST_ROWS = 1_000_000  # a list has no more
MOST_CELLS = 4000  # with more cells the file would be too long, so points are ranges instead

TEXTS: dict[str, Callable[[Iterable[Point]], str]] = {".toml": toml_text, ".csv": csv_text}


def check(options: argparse.Namespace) -> int:
    """
    Print what each file contains, or its mistakes on stderr, and what a device lacks of it; return
    2 after a mistake, 1 if the device lacks something.
    """
    list_options = ListOptions(**list_keys(options))
    if options.device is None:
        refuse_options(options, OF_CLIENTS, "needs --device")
        return max([_check_file(file, list_options) for file in options.files])
    options.url = options.device
    with closing(new_client(options)) as context:
        return max([_check_file(file, list_options, context) for file in options.files])


def _check_file(file: str, list_options: ListOptions, context: Client | None = None) -> int:
    try:
        contents = contents_of(map_file(file), MOST_MISTAKES, list_options)
    except ValueError as error:
        complain(str(error))
        return 2
    for mistake in contents.mistakes:
        complain(str(mistake))
    if len(contents.mistakes) == MOST_MISTAKES:
        complain("and possibly more")
    if contents.mistakes:
        return 2
    points = RegisterMap(contents.points.values())
    print(f"{file}: {counted(len(points), 'point')}")
    for line in [*_tables(points), *_more(points), *remarks(contents)]:
        print(f"  {line}")
    return 0 if context is None else _check_device(points, context)


def _tables(points: RegisterMap) -> Iterator[str]:
    """Yield a line for each table that has points, followed by its requests."""
    requests: list[Any] = [*points.plan().requests]
    for table, rules in TABLES.items():
        of_table = [point for point in points.values() if point.table == table]
        if of_table:
            writable = sum(point.is_writable for point in of_table)
            what = f", {writable} of them can be written" if writable else ""
            borders = ", ".join(str(address) for _, address in borders_of(of_table))
            what += f", no read crosses {borders}" if borders else ""
            yield f"{table}: {counted(len(of_table), 'point')}{what}"
        function = rules.read(0, 1).function
        for request in requests:
            if request.function == function:
                yield f"  read {request.address} {request.count}"


def _more(points: RegisterMap) -> Iterator[str]:
    """Yield a line for what the requests do not show of points."""
    if points.initial:
        yield f"{counted(len(points.initial), 'point')} with initial values"
    for point in points.values():
        if point.rewrite is not None:
            yield f"{point.name} is written again each {point.rewrite:g} s"
        if point.states is not None and any(isinstance(key, str) for key in point.states):
            names = ", ".join(f"{key} = {name}" for key, name in point.states.items())
            yield f"{point.name}: {names}"


def _check_device(points: RegisterMap, context: Client) -> int:
    """Print the points that a device refuses; return 1 if there are any."""
    context.connect()
    values = context.read_map(points, return_exceptions=True)
    errors = {
        name: value
        for name, value in values.items()
        if isinstance(value, ModbusError) and not isinstance(value, NoValue)
    }
    device = f"{context.url}, unit {context.unit}"
    for error in errors.values():
        if not isinstance(error, ExceptionResponse):
            raise error
    if errors and len(errors) == len(values):
        error = next(iter(errors.values()))
        complain(f"{device}: all {counted(len(values), 'point')} refused: {error}")
        return 1
    print(f"  {device}: {len(values) - len(errors)} of {counted(len(values), 'point')} can be read")
    sys.stdout.flush()
    for name, error in errors.items():
        complain(f"{name} cannot be read: {error}")
    return 1 if errors else 0


def import_list(options: argparse.Namespace) -> int:
    """Write a map of a list, and say what was understood; return 1 if something is left out."""
    check_output(options.output, TEXTS)
    contents = contents_of(options.file, MOST_ROWS, ListOptions(**list_keys(options)))
    points, mistakes = contents.points, contents.mistakes
    if not points:
        for mistake in mistakes[:MOST_MISTAKES]:
            complain(str(mistake))
        return 2
    while wrong := dict(scale_mistakes(points)):
        for name, error in wrong.items():
            del points[name]
            mistakes.append(MapError.of(error, contents.place(name)))
    lines = [
        ", ".join(f"{kind} is {head}" for kind, head in contents.columns.items() if kind != head),
        *contents.notes,
        *(f"left out: {mistake.in_file('')}" for mistake in mistakes[:MOST_MISTAKES]),
        *([f"and {len(mistakes) - MOST_MISTAKES} more"] if len(mistakes) > MOST_MISTAKES else []),
    ]
    write_map(
        options.output,
        [f"# {PurePath(options.file).name}, read by {PROGRAM}", ""],
        [*points.values()],
        f", {len(mistakes)} left out" if mistakes else "",
    )
    for line in filter(None, lines):
        print(f"  {line}", file=sys.stderr)
    return 1 if mistakes else 0


def class_of(options: argparse.Namespace) -> int:
    """Write a class for a register map to a file, or print it."""
    map = load_map(map_file(options.file), **list_keys(options))
    text = class_text(map, PurePath(options.file).stem)
    check_output(options.output, [".py"], MARK)
    if options.output is None:
        print(text, end="", flush=True)
        return 0
    Path(options.output).write_text(text, encoding="utf-8")
    print(f"{options.output}: {counted(len(map), 'point')}", file=sys.stderr)
    return 0


def check_output(output: str | None, suffixes: Collection[str], mark: str | None = None) -> None:
    """Refuse a file that cannot be written, or that exists without the mark of its writer."""
    if output is None:
        return
    path = Path(output)
    if path.suffix.lower() not in suffixes:
        raise ValueError(f"{output}: it must end with {' or '.join(suffixes)}")
    if not path.absolute().parent.is_dir():
        raise ValueError(f"{output}: the folder does not exist")
    if not os.path.lexists(path):
        return
    if mark is None or mark not in path.read_text(encoding="utf-8", errors="replace"):
        raise ValueError(
            f"{output} exists, and would be overwritten; name another file, or delete it"
        )


# --- maps of devices -----------------------------------------------------------------


def from_device(options: argparse.Namespace) -> int:
    """Search the registers of a device, and write a map of them."""
    check_output(options.output, TEXTS)
    url = endpoint_of(options).url
    status = Status()
    result = search(url, on_progress=lambda state: status.show(progress(state)))
    code = 0
    try:
        with result:
            for _ in result:
                pass
    except KeyboardInterrupt:
        code = INTERRUPTED
    finally:
        status.clear()
    extents = result.extents
    points = _points(extents)
    if not points:
        reasons = dict.fromkeys(extent.ended or "no address can be read" for extent in extents)
        raise CommandError(f"no table can be read: {', '.join(reasons) or 'nothing was asked'}")
    heading = [
        f"# Addresses of {parse(url)} that can be read, found by {PROGRAM} map from-device",
        *(f"# {extent.table}: {missing(extent)}" for extent in extents if missing(extent)),
    ]
    write_map(options.output, heading, points, "; fill in names, types and units")
    return code


def from_sunspec(options: argparse.Namespace) -> int:
    """Find the SunSpec models of a device, and write a map of their points."""
    from ...tools.sunspec import discover

    check_output(options.output, TEXTS)
    with closing(new_client(options)) as context:
        device = discover(context)
    for remark in device.notes:
        complain(remark)
    heading = [
        f"# SunSpec models of {endpoint_of(options)}, found by {PROGRAM} map from-sunspec",
        f"# {', '.join(f'{model.id} {model.name}' for model in device)}",
        "",
    ]
    write_map(options.output, heading, [*device.map.values()])
    return 0


def _points(extents: list[Extent]) -> list[Point]:
    """Return a point for each cell, or for each range if there are very many cells."""
    ranges: list[tuple[Any, range]] = [
        (extent.table, cells) for extent in extents for cells in extent.ranges
    ]
    if sum(len(cells) for _, cells in ranges) <= MOST_CELLS:
        ranges = [(table, range(at, at + 1)) for table, cells in ranges for at in cells]
    prefixes = {table: table.partition("_")[0].removesuffix("s") for table in TABLES}  # "holding"
    return [
        Point(f"{prefixes[table]}_{cells.start}", table, cells.start, len(cells), access="read")
        for table, cells in ranges
    ]


def write_map(output: str | None, heading: list[str], points: list[Point], more: str = "") -> None:
    """Write a map to a new file, or print it if there is no name."""
    text_of = toml_text if output is None else TEXTS[PurePath(output).suffix.lower()]
    text = "\n".join([*heading, text_of(points)])
    try:
        with written_to(output):
            print(text, end="", flush=True)
    except OSError:
        if output is not None:  # the disk is full, and part of a map would look like a whole one
            Path(output).unlink(missing_ok=True)
        raise
    if output is not None:
        print(f"{output}: {counted(len(points), 'point')}{more}", file=sys.stderr)
