"""The command ports: the serial ports of this machine."""

from __future__ import annotations

import argparse
from dataclasses import asdict

from ...ports.serial_devices import SerialDevice, serial_devices
from .. import arguments
from ..output import harmless, print_csv, print_json
from ..parser import Parser, declare

DESCRIPTION = """\
List the serial ports of this machine, and what the system knows of them.
Nothing is sent, and no setting is changed. The name in /dev/serial/by-id stays
the same when ports change their numbers."""

EPILOG = """\
The exit code is 0, or 1 if there is no serial port.

examples:
  libmodbus-py ports
  libmodbus-py ports --all
  libmodbus-py ports --json
  libmodbus-py ports --csv ports.csv"""

COLUMNS = ("path", "state", "driver", "vendor", "product", "serial_number", "stable_path")


def add_command(command: Parser) -> None:
    command.description, command.epilog = DESCRIPTION, EPILOG
    declare(command, "--all\n  list those without a USB device too, such as ttyS0")
    arguments.add_forms(command.exclusive(), "print CSV")
    command.set_defaults(run=_ports)


def _ports(options: argparse.Namespace) -> int:
    every = serial_devices()
    devices = every if options.all else [each for each in every if each.vendor] or every
    if options.json:
        for each in devices:
            print_json(asdict(each))
    elif options.csv:
        print_csv([COLUMNS, *([getattr(each, name) for name in COLUMNS] for each in devices)])
    else:
        _print_table(devices)
    return 0 if every else 1


def _print_table(found: list[SerialDevice]) -> None:
    if not found:
        print("no serial port was found")
    width = max((len(each.path) for each in found), default=0)
    for each in found:
        number = each.serial_number and f"serial number {each.serial_number}"
        parts = [each.driver, each.vendor, each.product, number]
        about = ", ".join(part for part in parts if part)
        print(harmless(f"{each.path:<{width}}  {each.state}; {about}".rstrip("; ")))
        if each.stable_path:
            print(harmless(f"{'':<{width}}  {each.stable_path}"))
