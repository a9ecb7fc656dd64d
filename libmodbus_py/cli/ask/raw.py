"""
The command raw: any function, its data in hex, and what comes back.
"""

from __future__ import annotations

import argparse
from typing import Any

from .. import connecting

__all__ = ["add_command"]

EXAMPLES = """\
examples:
  libmodbus-py raw 192.0.2.10 3 0000 000a
  libmodbus-py raw 192.0.2.10 0x2B "0E 01 00" -v
  libmodbus-py raw /dev/ttyUSB0 -b 9600 -u 7 43 0D0102
  libmodbus-py raw 'tcp://192.0.2.10?unit=7&timeout=0.5' 100"""


def add_command(commands: Any) -> None:
    """Tell argparse of it."""
    command = commands.add_parser(
        "raw",
        description="Sends a function and its data as they are. Prints the response, function"
        " first, and\nwhat it says, where the function is known.",
        epilog=f"{EXAMPLES}\n\n{connecting.URLS}",
    )
    connecting.add_arguments(command)
    command.add_argument("function", metavar="FUNCTION", help="1..127")
    command.add_argument("data", metavar="HEX", nargs="*", help="what follows the function")
    command.set_defaults(run=_raw)


def _raw(options: argparse.Namespace) -> int:
    from .telling import raw

    return raw(options)
