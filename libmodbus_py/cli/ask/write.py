"""
The command write: what it takes.
"""

from __future__ import annotations

import argparse
from typing import Any

from .. import connecting
from .read import WHAT, add_completer, add_item_arguments

__all__ = ["add_command"]

EXAMPLES = """\
examples:
  libmodbus-py write 192.0.2.10 holding 0 555 0 100 coils 7 on
  libmodbus-py write /dev/ttyUSB0 -b 9600 40123 3.14 --type float32 --order CDAB
  libmodbus-py write 192.0.2.10 --map meter.csv setpoint 21.5 --dry-run -v
  libmodbus-py write 'tcp://192.0.2.10?unit=7&timeout=0.5' holding 4 --mask 0xFFF0 0x0005"""


def add_command(commands: Any) -> None:
    """Tell argparse of it."""
    command = commands.add_parser(
        "write",
        description="Writes one request for each WHAT; all is checked before the first.\n\n"
        f"{WHAT},\n"
        "      and its values; several may follow each other. Coils take 0 1 off on false true.\n"
        "      Text that begins with - goes behind --, and options before that.",
        epilog=f"{EXAMPLES}\n\n{connecting.URLS}",
    )
    connecting.add_arguments(command)
    what = command.add_argument(
        "what", metavar="WHAT VALUE", nargs="+", help="what, and the values"
    )
    add_completer(what)
    add_item_arguments(command)
    group = command.add_argument_group("how")
    group.add_argument(
        "--multiple", action="store_true", help="functions 15 and 16 for one value, too, not 5, 6"
    )
    group.add_argument(
        "--mask",
        nargs=2,
        metavar=("AND", "OR"),
        help="in place of values: the register AND this, OR what of that AND has not (22)",
    )
    group.add_argument(
        "--and-read",
        nargs=2,
        metavar=("ADDRESS", "COUNT"),
        help="holding registers that the same request reads behind the write (23)",
    )
    group.add_argument("--dry-run", action="store_true", help="show the frames, and send nothing")
    command.set_defaults(run=_write)


def _write(options: argparse.Namespace) -> int:
    from .writing import write

    return write(options)
