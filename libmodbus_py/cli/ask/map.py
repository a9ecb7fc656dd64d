"""The command map: the arguments of its actions, and the action list."""

from __future__ import annotations

import argparse
from functools import partial
from textwrap import fill
from typing import Any

from .. import arguments
from ..arguments import maps, names_of_maps
from ..output import complain
from ..parser import Parser, declare

CHECK = "check register maps, and print their points and requests"
LIST = "list the register maps that come with the package"
CLASS = "write a Python class for a register map, in which type checkers find wrong names"
IMPORT = "make a map of the register list of a vendor or another program, and say what was read"
FROM_DEVICE = "find the addresses of a device by reading, and write a map of them"
FROM_SUNSPEC = "find the SunSpec models of a device, and write a map of their points"

OF_FILE = "such as meter.csv, or a name that list prints"

TO_FILL_IN = ", in which names, types and units remain to be filled in"

EXAMPLES = """\
examples:
  libmodbus-py map check meter.csv --device 192.0.2.10
  libmodbus-py map import registers.xlsx -o meter.toml
  libmodbus-py map from-device /dev/ttyUSB0 -b 9600 -p none -u 7 -o meter.csv
  libmodbus-py map class meter.csv -o meter.py"""

OF_CHECK = f"""\
The exit code is 0 if all files are right, 2 if one contains a mistake, 1 if
the device lacks a point or does not answer.

examples:
  libmodbus-py map check meter.csv
  libmodbus-py map check meter inverter.toml
  libmodbus-py map check meter.csv --device 192.0.2.10 -u 17
  libmodbus-py map check meter.csv --device /dev/ttyUSB0 -b 9600 -p none

{arguments.URLS}"""

OF_IMPORT = """\
FILE is a table in CSV, TSV, Markdown or .xlsx. Rows that a map cannot say are
left out, and named. The exit code is 0 if there are none, 1 if there are, and
2 if the headings have no meaning, or two.

examples:
  libmodbus-py map import registers.xlsx -o meter.toml
  libmodbus-py map import f1145.csv --from nibe -o pump.toml
  libmodbus-py map import zaehler.csv --encoding cp1252 --column scale=Faktor
  libmodbus-py map import holding.tsv --from iobroker --list table=holding"""

OF_LIST = """\
The exit code is 0, or 1 if nothing has the words of --search.

examples:
  libmodbus-py map list
  libmodbus-py map list --search eastron
  libmodbus-py map check sdm120
  libmodbus-py read 192.0.2.10 --map sdm120"""

OF_CLASS = """\
examples:
  libmodbus-py map class meter.csv
  libmodbus-py map class meter.csv -o meter.py
  libmodbus-py map class inverter.toml --output inverter.py
  libmodbus-py map class sdm120 -o sdm120.py"""

OF_DEVICE = f"""\
examples:
  libmodbus-py map from-device 192.0.2.10 > meter.toml
  libmodbus-py map from-device 192.0.2.10 -u 17 -o meter.csv
  libmodbus-py map from-device /dev/ttyUSB0 -b 9600 -p none -o meter.toml
  libmodbus-py map from-device 192.0.2.10 --timeout 300ms -o meter.csv

{arguments.URLS}"""

OF_SUNSPEC = f"""\
It needs the package pysunspec2.

examples:
  libmodbus-py map from-sunspec 192.0.2.10 > inverter.toml
  libmodbus-py map from-sunspec 192.0.2.10 -u 126 -o inverter.toml
  libmodbus-py map from-sunspec /dev/ttyUSB0 -b 9600 -o inverter.csv
  libmodbus-py map from-sunspec 192.0.2.10 --timeout 3s -o inverter.csv

{arguments.URLS}"""

DEVICE = """
--device URL
    read all points of this device, and print those that it refuses
"""

SEARCH = """
--search WORD ...
    print those alone whose name or description, which begins with the vendor, has all these words
"""

OF_OUTPUT = "-o --output FILE\n  a new file, .toml or .csv (TOML, printed)"

OF_CLASS_OUTPUT = """
-o --output FILE
    a .py file, new or written by this command before (printed)
"""


def add_command(command: Parser) -> None:
    command.epilog = EXAMPLES
    add_action = command.add_commands("ACTION")

    def add(name: str, about: str, epilog: str, more: str = "") -> Any:
        text = f"{fill(about[0].upper() + about[1:] + more, 79)}."
        action = add_action(name, about, description=text, epilog=epilog)
        action.set_defaults(run=partial(_run, name))
        return action

    check = add("check", CHECK, OF_CHECK)
    declare(check, f"FILE ...\n  {OF_FILE}", file={"dest": "files", "complete": maps})
    arguments.add_columns(check, rare="", encoding=True)
    declare(check, DEVICE)
    arguments.add_requests(check)
    import_command = add("import", IMPORT, OF_IMPORT)
    declare(import_command, "FILE\n  the list")
    arguments.add_columns(import_command, rare="", encoding=True)
    declare(import_command, OF_OUTPUT)
    search = {"action": "store", "nargs": "+", "default": [], "complete": names_of_maps}
    declare(add("list", LIST, OF_LIST, "; --map takes their names"), SEARCH, search=search)
    of_class = add("class", CLASS, OF_CLASS)
    declare(of_class, f"FILE\n  {OF_FILE}", file={"complete": maps})
    arguments.add_columns(of_class, rare="", encoding=True)
    declare(of_class, OF_CLASS_OUTPUT)
    device = add("from-device", FROM_DEVICE, OF_DEVICE, TO_FILL_IN)
    declare(device, f"{arguments.URL}{OF_OUTPUT}")
    arguments.add_client_options(device.group("requests"), usual=_timeouts)
    arguments.add_serial_options(device)
    arguments.add_security_options(device)
    from_sunspec = add("from-sunspec", FROM_SUNSPEC, OF_SUNSPEC)
    arguments.add_client(from_sunspec)
    declare(from_sunspec, OF_OUTPUT)


def _run(name: str, options: argparse.Namespace) -> int:
    if name == "list":
        return _list(options)
    from . import map_actions

    run = {
        "check": map_actions.check,
        "class": map_actions.class_of,
        "import": map_actions.import_list,
        "from-device": map_actions.from_device,
        "from-sunspec": map_actions.from_sunspec,
    }
    return run[name](options)


def _timeouts() -> dict[str, str]:
    from ...tools.scan.probe import ON_LINES, ON_NETWORKS

    return {"timeout": f"{ON_LINES:g}; on networks {ON_NETWORKS:g}"}


def _list(options: argparse.Namespace) -> int:
    from ...tools.simulator import example_files

    words = [word.casefold() for word in options.search]
    lines = [f"{name:<12} {about}" for name, about in example_files.maps().items()]
    matches = [line for line in lines if all(word in line.casefold() for word in words)]
    if not matches:
        complain(f"no register map of the {len(lines)} has {' and '.join(options.search)}")
        return 1
    print("\n".join(matches))
    return 0
