"""
The command identify: what a device says that it is (functions 43/14 and 17).
"""

from __future__ import annotations

import argparse
from typing import Any

from .. import connecting

__all__ = ["add_command"]

EXAMPLES = """\
examples:
  libmodbus-py identify 192.0.2.10
  libmodbus-py identify /dev/ttyUSB0 -b 9600 -u 7
  libmodbus-py identify 192.0.2.10 --level extended --json
  libmodbus-py identify 'tcp://192.0.2.10?unit=7&timeout=0.5' --level 4"""


def add_command(commands: Any) -> None:
    """Tell argparse of it."""
    command = commands.add_parser(
        "identify",
        description="Asks for the device identification (43/14) and the server id (17); devices"
        " have one,\nboth or neither. Exit code 1 if it is neither.",
        epilog=f"{EXAMPLES}\n\n{connecting.URLS}",
    )
    connecting.add_arguments(command)
    command.add_argument(
        "--level",
        default="regular",
        metavar="L",
        help="basic, regular, extended, or the id of one object (regular)",
    )
    command.add_argument("--json", action="store_true", help="print one object")
    command.set_defaults(run=_identify)


def _identify(options: argparse.Namespace) -> int:
    from .telling import identify

    return identify(options)
