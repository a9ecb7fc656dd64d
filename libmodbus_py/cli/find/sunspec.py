"""The command sunspec: the SunSpec models of a device, and their values."""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any

from ...client.blocking import Client
from .. import arguments
from ..ask.units import ask_units, fail, units_of
from ..output import complain, harmless, print_csv, print_json
from ..parser import Parser, declare

DESCRIPTION = """\
Print the SunSpec models of a device, and their values with units.
Values that the device has not implemented are left out of the table."""

EXAMPLES = """\
It needs the package pysunspec2.

examples:
  libmodbus-py sunspec 192.0.2.10
  libmodbus-py sunspec 192.0.2.10 --base 40000 --json
  libmodbus-py sunspec /dev/ttyUSB0 -b 9600 -u 1-4,126
  libmodbus-py sunspec 192.0.2.10 --csv > inverter.csv"""


def add_command(command: Parser) -> None:
    command.description, command.epilog = DESCRIPTION, f"{EXAMPLES}\n\n{arguments.URLS}"
    arguments.add_client(command, several=True)
    text = "the address at which the models begin (0, 40000 and 50000 are tried)"
    declare(command, f"--base A\n  {text}", base={"type": int})
    arguments.add_forms(command.exclusive(), "print CSV")
    command.set_defaults(run=_sunspec)


def _sunspec(options: argparse.Namespace) -> int:
    several = len(units_of(options)) > 1
    rows: list[dict[str, Any]] = []

    def report(client: Client) -> None:
        points = _asked(client, options.base)
        if several:
            points = [{"unit": client.unit, **row} for row in points]
        if options.csv:  # one table of all units
            rows.extend(points)
        elif options.json:
            for row in points:
                print_json(row)
        else:
            _print_table(points)

    code = ask_units(options, report, partial(fail, as_json=options.json, lacks="models"))
    if rows:
        print_csv([rows[0], *(map(_text, row.values()) for row in rows)])
    return code


def _asked(context: Client, base: int | None) -> list[dict[str, Any]]:
    """Return a row for each point of each model of a unit."""
    from ...tools.sunspec import BASES, discover

    device = discover(context, bases=BASES if base is None else (base,))
    for note in device.notes:
        complain(note)
    values = context.read_map(device.map, return_exceptions=True)
    rows = []
    for model in device:
        for name, point in model.map.items():
            value = values[f"{model.name}.{name}"]
            is_missing = isinstance(value, Exception)
            where = {"model": model.id, "address": point.address, "name": f"{model.name}.{name}"}
            row = {**where, "value": None if is_missing else value, "units": point.units}
            rows.append({**row, "reason": str(value) if is_missing else ""})
    return rows


def _print_table(rows: list[dict[str, Any]]) -> None:
    if rows and "unit" in rows[0]:
        print(f"unit {rows[0]['unit']}:")
    rows_with_values = [row for row in rows if row["value"] is not None]
    width = max((len(row["name"]) for row in rows_with_values), default=0)
    for row in rows_with_values:
        line = f"{row['address']:>5}  {row['name']:<{width}}  {_text(row['value'])} {row['units']}"
        print(harmless(line.rstrip()))


def _text(value: Any) -> str:
    """Return a value for people: of named bits, the names of those that are set."""
    if isinstance(value, dict):
        return " ".join(name for name, is_set in value.items() if is_set) or "-"
    if isinstance(value, list):
        return " ".join(str(int(element)) for element in value)
    return "" if value is None else str(value)
