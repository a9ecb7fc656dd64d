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
    devices = every if options.all else [device for device in every if device.vendor] or every
    if options.json:
        for device in devices:
            print_json(asdict(device))
    elif options.csv:
        print_csv([COLUMNS, *([getattr(device, name) for name in COLUMNS] for device in devices)])
    else:
        _print_table(devices)
    return 0 if every else 1


def _print_table(devices: list[SerialDevice]) -> None:
    if not devices:
        print("no serial port was found")
    width = max((len(device.path) for device in devices), default=0)
    for device in devices:
        number = device.serial_number and f"serial number {device.serial_number}"
        parts = [device.driver, device.vendor, device.product, number]
        about = ", ".join(part for part in parts if part)
        print(harmless(f"{device.path:<{width}}  {device.state}; {about}".rstrip("; ")))
        if device.stable_path:
            print(harmless(f"{'':<{width}}  {device.stable_path}"))
