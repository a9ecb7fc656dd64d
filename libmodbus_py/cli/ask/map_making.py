"""
Register maps that are made by reading a device, or of its SunSpec models.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path, PurePath
from typing import Any

from ...maps.point import Point
from ...ports.endpoint import parse
from ...tools.files.maps.texts import csv_text, toml_text
from ...tools.scan.search import Extent, search
from ..connecting import connected, endpoint_of
from ..failing import CommandError
from ..main import INTERRUPTED
from ..output import PROGRAM, complain, counted
from ..screen import Status, missing, progress

__all__ = ["from_device", "from_sunspec"]

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
