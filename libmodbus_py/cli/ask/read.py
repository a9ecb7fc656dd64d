"""
The command read: its arguments.
"""

from __future__ import annotations

import argparse
import contextlib
import math
from typing import Any, get_args

from ...protocol.checks import DURATION, duration_of
from ...protocol.type_names import BitsType, NumberType, Order
from .. import arguments, completers
from ..completers import behind, completing
from ..help import make_rare
from ..serve import page

__all__ = ["WHAT", "add_command", "add_item_arguments", "names"]

WHAT = """\
WHAT is one of
  TABLE ADDRESS  coils, discrete, holding, input, file:N or fifo; address from 0
  REFERENCE      such as 40123, which is holding register 122
  NAME           a point of the register map that --map gives"""

EXAMPLES = """\
examples:
  libmodbus-py read 192.0.2.10 hr 0-9 coils 0 8 hr 100:float32
  libmodbus-py read /dev/ttyUSB0 -b 9600 -p none -u 7 30001 2 --type float32
  libmodbus-py read 192.0.2.10 -u 1-3,17 --map meter.csv voltage current --watch
  libmodbus-py read 'tcp://192.0.2.10?unit=7&timeout=0.5' ir 0 9 --csv log.csv"""


def add_command(commands: Any) -> None:
    """Add the command to argparse."""
    command = commands.add_parser(
        "read",
        description="Read values of a device, in as few requests as possible.\n\n"
        f"{WHAT}\n"
        "and may be followed by a number of values (1). Several may follow each other.\n"
        "An address may have a type (hr 100:float32) and be a range (hr 100-105).\n"
        "With --map and without WHAT, all points of the map are read.",
        epilog=f"{EXAMPLES}\n\n{arguments.URLS}",
    )
    arguments.add_url(command)
    what = command.add_argument("what", metavar="WHAT", nargs="*", help="the values to read")
    completing(what, names)
    command.add_argument(
        "--group",
        metavar="NAME",
        action="append",
        help="read the points of a group of the map; may be repeated",
    )
    add_item_arguments(command, ", or all, which shows every interpretation", can_show_all=True)
    group = command.add_argument_group("output")
    form = group.add_mutually_exclusive_group()
    form.add_argument("--hex", action="store_true", help="print registers in hexadecimal")
    arguments.add_csv(form)
    arguments.add_json(form)
    group.add_argument(
        "--watch",
        nargs="?",
        const=1.0,
        type=_seconds,
        metavar="SECONDS",
        help="poll until Ctrl-C, each second unless given; on a terminal in a table",
    )
    group.add_argument(
        "--count", type=_polls, metavar="N", help="end after N polls; implies --watch"
    )
    group.add_argument(
        "--for",
        dest="lasts",
        type=_seconds,
        metavar="SECONDS",
        help="end after a time, such as 90 or 1h30m; implies --watch",
    )
    page.add_argument(group, "the values of --watch")
    arguments.add_requests(command, several=True)
    command.set_defaults(run=_read)


def add_item_arguments(
    command: argparse.ArgumentParser, more: str = "", *, can_show_all: bool = False
) -> None:
    """Add the arguments that say how values are stored in a device."""
    group = command.add_argument_group("values")
    types = ", ".join((*get_args(NumberType), *get_args(BitsType)))
    orders = ", ".join(get_args(Order))
    kind = group.add_argument("--type", metavar="T", help=f"type: {types}, string:N{more}")
    completing(kind, completers.types)
    order = group.add_argument("--order", metavar="O", help=f"byte order: {orders}")
    encoding = group.add_argument("--encoding", metavar="E", help="encoding of text")
    padding = group.add_argument("--padding", metavar="C", help="character that fills up text")
    make_rare(encoding, padding)
    arguments.add_defaults([order, encoding, padding], _of_reads)
    completing(order, completers.orders)
    completing(encoding, completers.encodings)
    file = group.add_argument(
        "--map",
        metavar="FILE",
        help="register map, CSV or TOML, or an example such as meter",
    )
    completing(file, completers.maps)
    make_rare(arguments.add_columns(group))
    group.add_argument(
        "--count-from-1", action="store_true", help="addresses count from 1, both typed and printed"
    )
    command.set_defaults(can_show_all=can_show_all)


def _of_reads() -> dict[str, Any]:
    from dataclasses import fields

    from ...maps.plan import Read

    return {each.name: each.default for each in fields(Read)} | {"padding": "NUL"}


def names(parsed_args: argparse.Namespace, **_: Any) -> list[str]:
    """Return the tables, and the names in the map, wherever on the line the map is."""
    from .items import TABLE_WORDS, map_of

    found: list[str] = []
    parsed_args.map = parsed_args.map or behind("--map") or None
    with contextlib.suppress(OSError, ValueError):
        found = [*(map_of(parsed_args) or ())]
    return [*TABLE_WORDS, *found]


def _seconds(text: str) -> float:
    try:
        seconds = duration_of(text)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} must be {DURATION}; --watch without a number must be the last argument"
        ) from None
    if not (math.isfinite(seconds) and 0.01 <= seconds <= 86_400):
        raise argparse.ArgumentTypeError(f"must be in 0.01..86400 seconds, not {text}")
    return seconds


def _polls(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 1_000_000_000:
        raise argparse.ArgumentTypeError(f"must be a number of polls, 1 or more, not {text!r}")
    return int(text)


def _read(options: argparse.Namespace) -> int:
    if options.watch is None and (options.count or options.lasts or options.page):
        options.watch = 1.0
    if options.watch is None:
        from .reading import read

        return read(options)
    from .watching import watch

    return watch(options)
