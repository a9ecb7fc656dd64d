"""The commands read and write: their arguments. What they do is imported when they run."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterable
from typing import Any, get_args

from ...protocol.checks import DURATION, duration_of
from ...protocol.words import BitsType, NumberType, Order, TimeType
from .. import arguments
from ..arguments import maps
from ..parser import Parser, declare
from ..serve import over_http

WHAT = """\
WHAT is one of
  TABLE ADDRESS  coils, discrete, holding, input, file:N or fifo; address from 0
  REFERENCE      such as 40123, which is holding register 122
  NAME           a point of the register map that --map gives"""

READ = f"""\
Read values of a device, in as few requests as possible.

{WHAT}
and may be followed by a number of values (1). Several may follow each other.
An address may have a type (hr 8:float32:CDAB), a range (8-15), a bit (8.15).
With --map and without WHAT, all points of the map are read."""

READING = """\
examples:
  libmodbus-py read 192.0.2.10 hr 0-9 coils 0 8 hr 100:float32
  libmodbus-py read /dev/ttyUSB0 -b 9600 -p none -u 7 30001 2 --type float32
  libmodbus-py read 192.0.2.10 -u 1-3,17 --map meter.csv voltage current --watch
  libmodbus-py read 'tcp://192.0.2.10?unit=7&timeout=0.5' ir 0 9 --csv log.csv"""

WRITE = f"""\
Write values to a device, one request for each WHAT. All values are
checked before the first request.

{WHAT}
followed by its values, as in hr 10 5 6, 40011=5 or hr 10.3=on, a bit. Several
may follow each other. Values of coils and bits are 0, 1, off, on, false, true.
After -- a text may begin with -; options must be before it."""

WRITING = """\
examples:
  libmodbus-py write 192.0.2.10 40001=555 hr 4:float32=3.5 coils 7 on --verify
  libmodbus-py write /dev/ttyUSB0 -b 9600 40123 3.14 --type float32 --order CDAB
  libmodbus-py write 192.0.2.10 --map meter.csv setpoint 21.5 --dry-run -v
  libmodbus-py write 'tcp://192.0.2.10?unit=7&timeout=0.5' hr 4 --mask 0xFFF0 5"""

OF_READ = """
[WHAT ...]
    the values to read
--group NAME ...
    read the points of a group of the map; may be repeated
"""


def _families(names: Iterable[str]) -> str:
    """Return names such as int8 and int16 as int8/16."""
    families: dict[str, list[str]] = {}
    for name in names:
        family = name.rstrip("0123456789")
        families.setdefault(family, []).append(name.removeprefix(family))
    return ", ".join(family + "/".join(bits) for family, bits in families.items())


OF_VALUES = f"""
--type T
    type: {_families((*get_args(NumberType), *get_args(BitsType)))}, string:N%s
--order O
    byte order: {", ".join(get_args(Order))}
rare --encoding E
    encoding of text
rare --padding C
    character that fills up text
"""

OF_REQUESTS = """
rare --max-registers N
    the most registers of one request, for devices that accept only short ones
"""

OF_WATCH = """
--watch [SECONDS]
    poll until Ctrl-C, by default each second; on a terminal in a table
--count N
    end after N polls; implies --watch
--for SECONDS
    end after a time, such as 90 or 1h30m; implies --watch
"""

OF_REGISTERS = """
--mask AND OR
    in place of values: keep the bits of AND, take the others from OR (function 22)
--and-read ADDRESS COUNT
    holding registers that are read after the write, by the same request (23)
"""

OF_SENDING = """
--verify
    read back what was written, and compare; the exit code is 1 if anything differs
--dry-run
    print the frames instead of sending them
"""


def add_command(command: Parser) -> None:
    (_add_read if command.prog.endswith(" read") else _add_write)(command)


def _add_read(command: Parser) -> None:
    command.description, command.epilog = READ, f"{READING}\n\n{arguments.URLS}"
    declare(command, f"{arguments.URL}{OF_READ}", what={"complete": names})
    _add_item_arguments(command, ", or all, which shows every interpretation")
    declare(command, OF_REQUESTS, max_registers={"default": 125})
    group = command.group("output")
    form = group.exclusive()
    declare(form, "--hex\n  print registers in hexadecimal")
    arguments.add_forms(form, "print CSV", csv_file="add rows to FILE")
    declare(
        group,
        OF_WATCH,
        watch={"const": 1.0, "type": _seconds},
        count={"type": _polls},
        **{"for": {"dest": "lasts", "type": _seconds}},
    )
    over_http.add_page(group, "the values of --watch")
    arguments.add_requests(command, several=True)
    command.set_defaults(run=_read, adds_rows=True)


def _add_write(command: Parser) -> None:
    command.description, command.epilog = WRITE, f"{WRITING}\n\n{arguments.URLS}"
    text = f"{arguments.URL}WHAT VALUE ...\n  the values to write"
    declare(command, text, what={"nargs": "+", "complete": names})
    _add_item_arguments(command)
    group = command.group("writing")
    declare(group, "--multiple\n  write single values with functions 15 and 16, not with 5 and 6")
    declare(group.exclusive(), OF_REGISTERS)
    declare(group, OF_SENDING)
    arguments.add_requests(command)
    command.set_defaults(run=_write)


def _add_item_arguments(command: Parser, more: str = "") -> None:
    group = command.group("values")
    types = [*get_args(NumberType), *get_args(BitsType), *get_args(TimeType), "string:"]
    orders = {"complete": get_args(Order)}
    declare(group, OF_VALUES % more, _of_reads, type={"complete": types}, order=orders)
    text = "register map, CSV or TOML, or an example such as meter"
    declare(group, f"--map FILE\n  {text}", map={"complete": maps})
    arguments.add_columns(group)
    declare(group, "--count-from-1\n  addresses count from 1, both typed and printed")


def _of_reads() -> dict[str, Any]:
    from dataclasses import fields

    from ...maps.items import Read

    return {field.name: field.default for field in fields(Read)} | {"padding": "NUL"}


def names(parsed_args: argparse.Namespace, **_: Any) -> list[str]:
    """Return the tables, and the names in the map that was typed before."""
    from .items import TABLE_WORDS, map_of

    parts = [part for word in parsed_args.words for part in word.split("=", 1)]
    with contextlib.suppress(OSError, ValueError, IndexError):
        parsed_args.map = parts[parts.index("--map") + 1]
        return [*TABLE_WORDS, *(map_of(parsed_args) or ())]
    return [*TABLE_WORDS]


def _seconds(text: str) -> float:
    try:
        seconds = duration_of(text)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} must be {DURATION}; --watch without a number must be the last argument"
        ) from None
    if not 0.01 <= seconds <= 86_400:
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


def _write(options: argparse.Namespace) -> int:
    from .writing import write

    return write(options)
