"""
The command read: what it takes.
"""

from __future__ import annotations

import argparse
import contextlib
import math
from typing import Any, get_args

from ...protocol.type_names import BitsType, NumberType, Order
from .. import connecting

__all__ = ["WHAT", "add_command", "add_completer", "add_item_arguments"]

WHAT = """\
WHAT: TABLE ADDRESS (coils, discrete, holding, input, file:N, fifo; from 0), a reference (40123:
      holding register 122), or a name of a register map"""

EXAMPLES = """\
examples:
  libmodbus-py read 192.0.2.10 holding 0 10 coils 0 8
  libmodbus-py read /dev/ttyUSB0 -b 9600 -p none -u 7 30001 2 --type float32
  libmodbus-py read 192.0.2.10 --map meter.csv voltage current --watch
  libmodbus-py read 'tcp://192.0.2.10?unit=7&timeout=0.5' input 0 20 --watch 10 --csv > log.csv"""


def add_command(commands: Any) -> None:
    """Tell argparse of it."""
    command = commands.add_parser(
        "read",
        description=f"Reads as much as you like, in as few requests as it takes.\n\n{WHAT},\n"
        "      and how many (1); several may follow each other; with --map alone, all of the map",
        epilog=f"{EXAMPLES}\n\n{connecting.URLS}",
    )
    connecting.add_arguments(command)
    what = command.add_argument("what", metavar="WHAT", nargs="*", help="what, and how many")
    add_completer(what)
    add_item_arguments(command, ", or all: every reading of COUNT registers", can_show_all=True)
    group = command.add_argument_group("what is printed")
    form = group.add_mutually_exclusive_group()
    form.add_argument("--hex", action="store_true", help="registers in hex")
    form.add_argument("--csv", action="store_true", help="a header, and a row for each poll")
    form.add_argument("--json", action="store_true", help="an object for each poll")
    group.add_argument(
        "--watch",
        nargs="?",
        const=1.0,
        type=_seconds,
        metavar="SECONDS",
        help="poll until Ctrl-C (every second): a table on a terminal, else a line each",
    )
    command.set_defaults(run=_read)


def add_item_arguments(
    command: argparse.ArgumentParser, more: str = "", *, can_show_all: bool = False
) -> None:
    """Tell argparse of what says how values lie in a device."""
    group = command.add_argument_group("what it means")
    types = ", ".join((*get_args(NumberType), *get_args(BitsType)))
    orders = ", ".join(get_args(Order))
    group.add_argument("--type", metavar="T", help=f"of values: {types}, string:N{more}")
    group.add_argument("--order", metavar="O", help=f"of their bytes: {orders} (ABCD)")
    group.add_argument("--encoding", metavar="E", help="of text (ascii)")
    group.add_argument("--padding", metavar="C", help="the character that fills text up (NUL)")
    group.add_argument(
        "--map",
        metavar="FILE",
        help="a register map, CSV or TOML, for names; or an example's, such as meter",
    )
    group.add_argument(
        "--count-from-1", action="store_true", help="addresses are from 1, typed and shown"
    )
    command.set_defaults(can_show_all=can_show_all)


def add_completer(what: argparse.Action) -> None:
    """Let shells complete the tables, and the names of the map that was given."""
    what.completer = _names  # type: ignore[attr-defined]


def _names(parsed_args: argparse.Namespace, **_: Any) -> list[str]:
    from .items import TABLE_WORDS, map_of

    names: list[str] = []
    with contextlib.suppress(OSError, ValueError):
        names = list(map_of(parsed_args.map)) if parsed_args.map else []
    return [*TABLE_WORDS, *names]


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} must be seconds; without a number --watch goes to the end"
        ) from None
    if not (math.isfinite(seconds) and 0.01 <= seconds <= 86_400):
        raise argparse.ArgumentTypeError(f"must be in 0.01..86400 seconds, not {text}")
    return seconds


def _read(options: argparse.Namespace) -> int:
    if options.watch is None:
        from .reading import read

        return read(options)
    from .watching import watch

    return watch(options)
