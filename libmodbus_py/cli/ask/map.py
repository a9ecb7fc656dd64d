"""
The command map: register maps, checked, or made of what a device has.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any

from ...maps.point import Point
from ...maps.register_map import RegisterMap
from ...ports.endpoint import parse
from ...protocol.tables import TABLES
from ...tools.files.maps.checking import remarks
from ...tools.files.maps.drafts import Contents, MapError
from ...tools.files.maps.map_file import contents_of
from ...tools.files.maps.texts import csv_text, toml_text
from ...tools.scan.search import Extent, search
from .. import security
from ..commands import PROGRAM
from ..connecting import url_of
from ..failing import CommandError
from ..find import scan
from ..main import INTERRUPTED
from ..output import counted
from ..status import Status

__all__ = ["add_command"]

MOST_MISTAKES = 20

# More than these would be a file that is too long: then ranges have names, not their cells.
MOST_CELLS = 4000

PREFIXES = {
    "coils": "coil",
    "discrete_inputs": "discrete",
    "holding_registers": "holding",
    "input_registers": "input",
}
"""Table -> how the names of points in a skeleton begin."""

TEXTS: dict[str, Callable[[Iterable[Point]], str]] = {".toml": toml_text, ".csv": csv_text}


def add_command(commands: Any) -> None:
    """Tell argparse of it."""
    command = commands.add_parser("map")
    actions = command.add_subparsers(metavar="ACTION", required=True)
    check = actions.add_parser(
        "check",
        help="say what register maps have, what it takes to read it, and what is wrong",
        epilog="exit code 0 if all files are right, 2 if one is not",
    )
    check.add_argument("files", metavar="FILE", nargs="+", help="such as meter.csv or meter.toml")
    check.set_defaults(run=_check, parser=check)
    skeleton = actions.add_parser(
        "from-device",
        help="find what a device has by reading alone, and make a map of it to be filled in",
    )
    skeleton.add_argument(
        "url", metavar="URL", help="such as 192.0.2.1 or 'tcp://192.0.2.1?unit=17'"
    )
    skeleton.add_argument(
        "-u", "--unit", type=int, metavar="N", help="0..255 (that of the URL, or 1)"
    )
    skeleton.add_argument(
        "--timeout", type=float, metavar="S", help="seconds for an answer (0.6; on networks 1)"
    )
    skeleton.add_argument(
        "-o", "--output", metavar="FILE", help="a new file, .toml or .csv (TOML, printed)"
    )
    security.add_arguments(skeleton)
    skeleton.set_defaults(run=_from_device, parser=skeleton)


# --- check -----------------------------------------------------------------------------


def _check(options: argparse.Namespace) -> int:
    return max([_check_file(file) for file in options.files])


def _check_file(file: str) -> int:
    try:
        contents = contents_of(file, MOST_MISTAKES)
    except MapError as error:
        return _wrong([str(error)])
    if contents.mistakes:
        more = ["and perhaps more"] * (len(contents.mistakes) == MOST_MISTAKES)
        return _wrong([*(str(each) for each in contents.mistakes), *more])
    print(f"{file}: {counted(len(contents.points), 'point')}")
    for line in [*_tables(contents), *remarks(contents)]:
        print(f"  {line}")
    return 0


def _wrong(lines: list[str]) -> int:
    for line in lines:
        print(f"{PROGRAM}: {line}", file=sys.stderr)
    return 2


def _tables(contents: Contents) -> list[str]:
    """A line for each table that has points, and one for each request to it."""
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


# --- from-device -----------------------------------------------------------------------


def _from_device(options: argparse.Namespace) -> int:
    text_of = _form(options.output)
    status = Status()
    searched = search(
        _url(options),
        timeout=options.timeout,
        security=security.told(options),
        on_progress=lambda told: status.show(scan.progress(told)),
    )
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
    _write(options.output, "\n".join([*_heading(_url(options), searched.extents), text_of(points)]))
    if options.output is not None:
        told = (
            f"{options.output}: {counted(len(points), 'point')}; names, types and units are yours"
        )
        print(told, file=sys.stderr)
    return code


def _form(output: str | None) -> Callable[[Iterable[Point]], str]:
    """How the file is written; it is looked at before minutes are spent."""
    if output is None:
        return toml_text
    text_of = TEXTS.get(PurePath(output).suffix.lower())
    if text_of is None:
        raise ValueError(f"{output}: it must end with one of {', '.join(TEXTS)}")
    if os.path.lexists(output):
        raise ValueError(f"{output} is there already, and would be lost")
    if not Path(output).absolute().parent.is_dir():
        raise ValueError(f"{output}: there is no such folder")
    return text_of


def _url(options: argparse.Namespace) -> str:
    endpoint = parse(url_of(options.url))
    if options.unit is None:
        return endpoint.url
    return replace(endpoint, client_options={**endpoint.client_options, "unit": options.unit}).url


def _points(extents: list[Extent]) -> list[Point]:
    """Each cell; of very many the ranges. Nothing is known of writing."""
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
    told = [(extent.table, scan.missing(extent)) for extent in extents]
    return [
        f"# What can be read of {parse(url)}, found by {PROGRAM} map from-device",
        *(f"# {table}: {text}" for table, text in told if text),
    ]


def _ended(extents: list[Extent]) -> str:
    reasons = dict.fromkeys(extent.ended or "no address is there" for extent in extents)
    return ", ".join(reasons) or "nobody was asked"


def _write(output: str | None, text: str) -> None:
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
