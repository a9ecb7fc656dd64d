"""
The command write: its arguments.
"""

from __future__ import annotations

import argparse
from typing import Any

from .. import arguments
from ..completers import completing
from .read import WHAT, add_item_arguments, names

__all__ = ["add_command"]

EXAMPLES = """\
examples:
  libmodbus-py write 192.0.2.10 40001=555 hr 4:float32=3.5 coils 7 on --verify
  libmodbus-py write /dev/ttyUSB0 -b 9600 40123 3.14 --type float32 --order CDAB
  libmodbus-py write 192.0.2.10 --map meter.csv setpoint 21.5 --dry-run -v
  libmodbus-py write 'tcp://192.0.2.10?unit=7&timeout=0.5' hr 4 --mask 0xFFF0 5"""


def add_command(commands: Any) -> None:
    """Add the command to argparse."""
    command = commands.add_parser(
        "write",
        description="Write values to a device, one request for each WHAT. All values are\n"
        f"checked before the first request.\n\n{WHAT}\n"
        "followed by its values, as in hr 10 5 6, or 40011=5. Several may follow each\n"
        "other. Values of coils are 0, 1, off, on, false and true. After -- a text may\n"
        "begin with -; options must be before it.",
        epilog=f"{EXAMPLES}\n\n{arguments.URLS}",
    )
    arguments.add_url(command)
    what = command.add_argument("what", metavar="WHAT VALUE", nargs="+", help="the values to write")
    completing(what, names)
    add_item_arguments(command)
    group = command.add_argument_group("writing")
    group.add_argument(
        "--multiple",
        action="store_true",
        help="write single values with functions 15 and 16, not with 5 and 6",
    )
    group.add_argument(
        "--mask",
        nargs=2,
        metavar=("AND", "OR"),
        help="in place of values: keep the bits of AND, take the others from OR (function 22)",
    )
    group.add_argument(
        "--and-read",
        nargs=2,
        metavar=("ADDRESS", "COUNT"),
        help="holding registers that are read after the write, by the same request (23)",
    )
    group.add_argument(
        "--verify",
        action="store_true",
        help="read back what was written, and compare; the exit code is 1 if anything differs",
    )
    group.add_argument(
        "--dry-run", action="store_true", help="print the frames instead of sending them"
    )
    arguments.add_requests(command)
    command.set_defaults(run=_write)


def _write(options: argparse.Namespace) -> int:
    from .writing import write

    return write(options)
