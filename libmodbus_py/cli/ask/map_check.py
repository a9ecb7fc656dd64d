"""
Register maps, checked.
"""

from __future__ import annotations

import argparse
from typing import Any

from ...maps.register_map import RegisterMap
from ...protocol.tables import TABLES
from ...tools.files.maps.checking import remarks
from ...tools.files.maps.drafts import Contents, MapError
from ...tools.files.maps.map_file import contents_of
from ..output import complain, counted

__all__ = ["check"]

MOST_MISTAKES = 20
"""Mistakes in a file that are printed, at most."""


def check(options: argparse.Namespace) -> int:
    """Print what each file contains, or its mistakes on stderr; return 2 after a mistake."""
    return max([_check_file(file) for file in options.files])


def _check_file(file: str) -> int:
    try:
        contents = contents_of(file, MOST_MISTAKES)
    except MapError as error:
        return _wrong([str(error)])
    if contents.mistakes:
        more = ["and possibly more"] * (len(contents.mistakes) == MOST_MISTAKES)
        return _wrong([*(str(each) for each in contents.mistakes), *more])
    print(f"{file}: {counted(len(contents.points), 'point')}")
    for line in [*_tables(contents), *remarks(contents)]:
        print(f"  {line}")
    return 0


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
