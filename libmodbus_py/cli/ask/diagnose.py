"""
The command diagnose: how a device and its line are (functions 7, 8, 11 and 12).
"""

from __future__ import annotations

import argparse
from typing import Any

from .. import connecting

__all__ = ["add_command"]

EXAMPLES = """\
examples:
  libmodbus-py diagnose /dev/ttyUSB0 -b 9600 -u 7
  libmodbus-py diagnose 192.0.2.10 return-query-data 0x1234
  libmodbus-py diagnose 192.0.2.10 clear-counters -v
  libmodbus-py diagnose 'rtu:///dev/ttyUSB0?baudrate=9600&unit=7' 11"""


def add_command(commands: Any) -> None:
    """Tell argparse of it."""
    command = commands.add_parser(
        "diagnose",
        description="Reads the exception status (7), the counters (8), the event counter (11) and"
        " the event\nlog (12): what the device has of them. Nothing is changed, unless a"
        " sub-function that\nchanges something is named.",
        epilog=f"{EXAMPLES}\n\n{connecting.URLS}",
    )
    connecting.add_arguments(command)
    command.add_argument(
        "sub_function",
        metavar="SUB-FUNCTION",
        nargs="?",
        help="of function 8, by name or number, such as clear-counters or 10",
    )
    command.add_argument("data", metavar="DATA", nargs="?", default="0", help="0..65535 (0)")
    command.add_argument("--json", action="store_true", help="print one object")
    command.set_defaults(run=_diagnose)


def _diagnose(options: argparse.Namespace) -> int:
    from .telling import diagnose

    return diagnose(options)
