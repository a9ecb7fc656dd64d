"""
Register maps, checked.
"""

from __future__ import annotations

import argparse
import sys
from contextlib import closing
from typing import Any

from ...client.blocking import Context
from ...maps.holes import Holes, carried_out, reading
from ...maps.point_plan import PointPlan
from ...maps.register_map import RegisterMap
from ...ports.schemes import CLIENT_OPTIONS, SECURITY_OPTIONS, SERIAL_OPTIONS
from ...protocol.errors import ExceptionResponse, ModbusError
from ...protocol.tables import TABLES
from ...tools.files.maps.contents import Contents, remarks
from ...tools.files.maps.map_file import contents_of
from ...tools.simulator.example_files import map_file
from .. import arguments
from ..connecting import connected
from ..output import complain, counted

__all__ = ["check"]

OF_DEVICES = (*CLIENT_OPTIONS, *SERIAL_OPTIONS, *SECURITY_OPTIONS)
"""Options that mean nothing without a device."""

MOST_MISTAKES = 20
"""Mistakes in a file that are printed, at most."""


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
    """
    Return all values of a device, or their errors, and how many requests a poll takes without the
    points that it refuses.

    Raises:
        ModbusError: the device does not answer.
    """

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
