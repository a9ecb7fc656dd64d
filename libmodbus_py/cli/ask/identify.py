"""
The command identify: device identification and server id (functions 43/14 and 17).
"""

from __future__ import annotations

import argparse
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from ...protocol.errors import ModbusError
from .. import arguments
from ..completers import completing, levels

if TYPE_CHECKING:
    from ...client.blocking import Context
    from ...protocol.pdu import ServerId

__all__ = ["add_command"]

EXAMPLES = """\
examples:
  libmodbus-py identify 192.0.2.10
  libmodbus-py identify /dev/ttyUSB0 -b 9600 -u 1-9,17
  libmodbus-py identify 192.0.2.10 --level extended --json
  libmodbus-py identify 'tcp://192.0.2.10?unit=7&timeout=0.5' --level 4"""


def add_command(commands: Any) -> None:
    """Add the command to argparse."""
    command = commands.add_parser(
        "identify",
        description="Print the device identification (function 43/14) and the server id\n"
        "(function 17). Devices have one, both or neither; with neither the exit code\n"
        "is 1.",
        epilog=f"{EXAMPLES}\n\n{arguments.URLS}",
    )
    arguments.add_client(command, several=True)
    level = command.add_argument(
        "--level",
        default="regular",
        metavar="L",
        help="basic, regular, extended, or the number of one object (regular)",
    )
    completing(level, levels)
    arguments.add_json(command)
    command.set_defaults(run=_identify)


def _identify(options: argparse.Namespace) -> int:
    from ...protocol.plain import number_of
    from .units import print_report, report_units

    level = options.level
    wanted: str | int = number_of("level", level) if level[:1].isdigit() else level

    def report(context: Context, several: bool) -> int:
        questions = {
            "identification": lambda: _objects(_identification(context, wanted)),
            "server id": lambda: _server_id(context.report_server_id()),
        }
        return print_report(context, questions, as_json=options.json, several=several)

    return report_units(options, report)


def _identification(context: Context, wanted: str | int) -> dict[int, bytes]:
    """Return the objects of a level; some devices leave out those of the basic level in others."""
    from ...protocol.pdu.interface import MANDATORY

    found = context.read_device_identification(wanted).objects
    if wanted in ("regular", "extended") and MANDATORY - found.keys():
        with suppress(ModbusError):
            found = {**context.read_device_identification("basic").objects, **found}
    return found


def _objects(objects: dict[int, bytes]) -> list[tuple[str, bytes]]:
    from ...protocol.pdu.interface import OBJECT_NAMES

    return [
        (OBJECT_NAMES.get(number, f"object {number}"), value)
        for number, value in sorted(objects.items())
    ]


def _server_id(server_id: ServerId) -> list[tuple[str, Any]]:
    told: list[tuple[str, Any]] = [("server id", server_id.data)]
    if server_id.running is not None:
        told.append(("running", server_id.running))
    return told
