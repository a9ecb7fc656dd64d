"""
The command map: check register maps, list those of the package, make a class of one, or a map of a
device.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import closing
from pathlib import Path, PurePath
from textwrap import fill
from typing import Any

from ...client.blocking import Context
from ...maps.point import Point
from ...maps.register_map import RegisterMap
from ...ports.endpoint import parse
from ...protocol.errors import ExceptionResponse, ModbusError
from ...protocol.tables import TABLES
from ...tools.files.map_file import contents_of, load_map, remarks
from ...tools.files.map_texts import MARK, class_text, csv_text, toml_text
from ...tools.scan.probe import ON_LINES, ON_NETWORKS
from ...tools.scan.search import Extent, search
from ...tools.simulator import example_files
from ...tools.simulator.example_files import map_file
from .. import arguments
from ..arguments import connected, declare, endpoint_of
from ..main import INTERRUPTED, CommandError
from ..output import PROGRAM, Status, complain, counted, missing, progress, written_to

__all__ = ["add_command"]

MOST_MISTAKES = 20
"""Mistakes in a file that are printed, at most."""

# With more cells the file would be too long, so points are ranges instead.
MOST_CELLS = 4000

Run = Callable[[argparse.Namespace], int]

TEXTS: dict[str, Callable[[Iterable[Point]], str]] = {".toml": toml_text, ".csv": csv_text}

CHECK = "check register maps, and print their points and requests"
LIST = "list the register maps that come with the package"
CLASS = "write a Python class for a register map, in which type checkers find wrong names"
FROM_DEVICE = "find the addresses of a device by reading, and write a map of them"
FROM_SUNSPEC = "find the SunSpec models of a device, and write a map of their points"

OF_FILE = "such as meter.csv, or a name that list prints"

TO_FILL_IN = ", in which names, types and units remain to be filled in"

EXAMPLES = """\
examples:
  libmodbus-py map check meter.csv --device 192.0.2.10
  libmodbus-py map from-device /dev/ttyUSB0 -b 9600 -p none -u 7 -o meter.csv
  libmodbus-py map class meter.csv -o meter.py
  libmodbus-py map from-device "tcp://192.0.2.10?unit=17" > meter.toml"""

OF_CHECK = f"""\
The exit code is 0 if all files are right, 2 if one contains a mistake, 1 if
the device lacks a point or does not answer.

examples:
  libmodbus-py map check meter.csv
  libmodbus-py map check meter inverter.toml
  libmodbus-py map check meter.csv --device 192.0.2.10 -u 17
  libmodbus-py map check meter.csv --device /dev/ttyUSB0 -b 9600 -p none

{arguments.URLS}"""

OF_LIST = """\
The exit code is 0, or 1 if nothing has the words of --search.

examples:
  libmodbus-py map list
  libmodbus-py map list --search eastron
  libmodbus-py map check sdm120
  libmodbus-py read 192.0.2.10 --map sdm120"""

OF_CLASS = """\
examples:
  libmodbus-py map class meter.csv
  libmodbus-py map class meter.csv -o meter.py
  libmodbus-py map class inverter.toml --output inverter.py
  libmodbus-py map class sdm120 -o sdm120.py"""

OF_DEVICE = f"""\
examples:
  libmodbus-py map from-device 192.0.2.10 > meter.toml
  libmodbus-py map from-device 192.0.2.10 -u 17 -o meter.csv
  libmodbus-py map from-device /dev/ttyUSB0 -b 9600 -p none -o meter.toml
  libmodbus-py map from-device 192.0.2.10 --timeout 300ms -o meter.csv

{arguments.URLS}"""

OF_SUNSPEC = f"""\
It needs the package pysunspec2.

examples:
  libmodbus-py map from-sunspec 192.0.2.10 > inverter.toml
  libmodbus-py map from-sunspec 192.0.2.10 -u 126 -o inverter.toml
  libmodbus-py map from-sunspec /dev/ttyUSB0 -b 9600 -o inverter.csv
  libmodbus-py map from-sunspec 192.0.2.10 --timeout 3s -o inverter.csv

{arguments.URLS}"""


SEARCH = """
--search WORD ...
    print those alone whose name or description, which begins with the vendor, has all these words
"""

OF_OUTPUT = "-o --output FILE\n  a new file, .toml or .csv (TOML, printed)"

OF_CLASS_OUTPUT = "-o --output FILE\n  a .py file, new or written by this command before (printed)"


def add_command(command: argparse.ArgumentParser) -> None:
    """Declare the arguments of each action."""
    command.epilog = EXAMPLES
    actions = command.add_subparsers(metavar="ACTION", required=True)

    def add(name: str, run: Run, about: str, epilog: str, more: str = "") -> Any:
        text = f"{fill(about[0].upper() + about[1:] + more, 79)}."
        action = actions.add_parser(name, help=about, description=text, epilog=epilog)
        action.set_defaults(run=run)
        return action

    check = add("check", _check, CHECK, OF_CHECK)
    declare(check, f"FILE ...\n  {OF_FILE}", file={"dest": "files", "complete": arguments.maps})
    arguments.add_columns(check, rare="")
    declare(
        check, "--device URL\n  read all points of this device, and print those that it refuses"
    )
    arguments.add_requests(check)
    search = {"action": "store", "nargs": "+", "default": [], "complete": arguments.names_of_maps}
    declare(add("list", _list, LIST, OF_LIST, "; --map takes their names"), SEARCH, search=search)
    made = add("class", _class, CLASS, OF_CLASS)
    declare(made, f"FILE\n  {OF_FILE}", file={"complete": arguments.maps})
    arguments.add_columns(made, rare="")
    declare(made, OF_CLASS_OUTPUT)
    device = add("from-device", _from_device, FROM_DEVICE, OF_DEVICE, TO_FILL_IN)
    declare(device, f"{arguments.URL}{OF_OUTPUT}")
    arguments.add_client_options(
        device.add_argument_group("requests"),
        usual=lambda: {"timeout": f"{ON_LINES:g}; on networks {ON_NETWORKS:g}"},
    )
    arguments.add_serial_options(device)
    arguments.add_security_options(device)
    from_sunspec = add("from-sunspec", _from_sunspec, FROM_SUNSPEC, OF_SUNSPEC)
    arguments.add_client(from_sunspec)
    declare(from_sunspec, OF_OUTPUT)


def _list(options: argparse.Namespace) -> int:
    words = [word.casefold() for word in options.search]
    lines = [f"{name:<12} {about}" for name, about in example_files.maps().items()]
    found = [line for line in lines if all(word in line.casefold() for word in words)]
    if not found:
        complain(f"no register map of the {len(lines)} has {' and '.join(options.search)}")
        return 1
    print("\n".join(found))
    return 0


def _check(options: argparse.Namespace) -> int:
    """
    Print what each file contains, or its mistakes on stderr, and what a device lacks of it; return
    2 after a mistake, 1 if the device lacks something.
    """
    columns = dict(options.columns)
    if options.device is None:
        arguments.refuse_given(options, arguments.OF_CLIENTS, "needs --device")
        return max([_check_file(file, columns) for file in options.files])
    options.url = options.device
    with closing(connected(options)) as context:
        return max([_check_file(file, columns, context) for file in options.files])


def _check_file(file: str, columns: dict[str, str], context: Context | None = None) -> int:
    try:
        contents = contents_of(map_file(file), MOST_MISTAKES, columns)
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
    for line in [*_tables(points), *remarks(contents)]:
        print(f"  {line}")
    return 0 if context is None else _check_device(points, context)


def _tables(points: RegisterMap) -> Iterator[str]:
    """Yield a line for each table that has points, followed by its requests."""
    requests: list[Any] = [*points.plan().requests]
    for table, rules in TABLES.items():
        found = [point for point in points.values() if point.table == table]
        if found:
            written = sum(point.is_writable for point in found)
            what = f", {written} of them can be written" if written else ""
            yield f"{table}: {counted(len(found), 'point')}{what}"
        function = rules.read(0, 1).function
        for each in requests:
            if each.function == function:
                yield f"  read {each.address} {each.count}"


def _check_device(points: RegisterMap, context: Context) -> int:
    """Print the points that a device refuses; return 1 if there are any."""
    context.connect()
    values = context.read_map(points, return_exceptions=True, max_in_flight=1)
    failed = {name: value for name, value in values.items() if isinstance(value, ModbusError)}
    device = f"{context.url}, unit {context.unit}"
    for error in failed.values():
        if not isinstance(error, ExceptionResponse):
            raise error
    if failed and len(failed) == len(values):
        error = next(iter(failed.values()))
        complain(f"{device}: all {counted(len(values), 'point')} refused: {error}")
        return 1
    print(f"  {device}: {len(values) - len(failed)} of {counted(len(values), 'point')} can be read")
    sys.stdout.flush()
    for name, error in failed.items():
        complain(f"{name} cannot be read: {error}")
    return 1 if failed else 0


def _class(options: argparse.Namespace) -> int:
    """Write a class for a register map to a file, or print it."""
    map = load_map(map_file(options.file), columns=dict(options.columns))
    text = class_text(map, PurePath(options.file).stem)
    if options.output is None:
        print(text, end="", flush=True)
        return 0
    _check_output(options.output, [".py"], MARK)
    Path(options.output).write_text(text, encoding="utf-8")
    print(f"{options.output}: {counted(len(map), 'point')}", file=sys.stderr)
    return 0


def _check_output(output: str, suffixes: Collection[str], mark: str | None = None) -> None:
    """Refuse a file that cannot be written, or that exists without the mark of its writer."""
    path = Path(output)
    if path.suffix.lower() not in suffixes:
        raise ValueError(f"{output}: it must end with {' or '.join(suffixes)}")
    if not path.absolute().parent.is_dir():
        raise ValueError(f"{output}: the folder does not exist")
    if not os.path.lexists(path):
        return
    if mark is None or mark not in path.read_text(encoding="utf-8", errors="replace"):
        raise ValueError(f"{output} exists, and would be overwritten")


# --- maps of devices -----------------------------------------------------------------


def _from_device(options: argparse.Namespace) -> int:
    """Find what a device has, and write a map of it."""
    if options.output is not None:
        _check_output(options.output, TEXTS)
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
    extents = searched.extents
    points = _points(extents)
    if not points:
        reasons = dict.fromkeys(extent.ended or "no address can be read" for extent in extents)
        raise CommandError(f"no table can be read: {', '.join(reasons) or 'nothing was asked'}")
    heading = [
        f"# Addresses of {parse(url)} that can be read, found by {PROGRAM} map from-device",
        *(f"# {each.table}: {missing(each)}" for each in extents if missing(each)),
    ]
    _write(options.output, heading, points, "; fill in names, types and units")
    return code


def _from_sunspec(options: argparse.Namespace) -> int:
    """Find the SunSpec models of a device, and write a map of their points."""
    from ...tools.sunspec import discover

    if options.output is not None:
        _check_output(options.output, TEXTS)
    with closing(connected(options)) as context:
        try:
            device = discover(context)
        except ImportError as error:
            raise CommandError(str(error)) from None
    for remark in device.notes:
        complain(remark)
    heading = [
        f"# SunSpec models of {endpoint_of(options)}, found by {PROGRAM} map from-sunspec",
        f"# {', '.join(f'{model.id} {model.name}' for model in device)}",
        "",
    ]
    _write(options.output, heading, [*device.map.values()])
    return 0


def _points(extents: list[Extent]) -> list[Point]:
    """Return a point for each cell, or for each range if there are very many cells."""
    found: list[tuple[Any, range]] = [
        (extent.table, cells) for extent in extents for cells in extent.ranges
    ]
    if sum(len(cells) for _, cells in found) <= MOST_CELLS:
        found = [(table, range(at, at + 1)) for table, cells in found for at in cells]
    return [
        Point(f"{_prefix(table)}_{cells.start}", table, cells.start, len(cells), access="read")
        for table, cells in found
    ]


def _prefix(table: str) -> str:
    """Return the first part of the names of points, such as "coil" or "holding"."""
    return table.partition("_")[0].removesuffix("s")


def _write(output: str | None, heading: list[str], points: list[Point], more: str = "") -> None:
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
