"""
Every command, with its file and its purpose; and the parser of what is typed.

The file of a command is imported when the command is typed. Its ``add_command`` adds the
arguments to argparse.
"""

from __future__ import annotations

import argparse
import re
from importlib import import_module

from ..version import __version__
from .help import Help, HelpAll, VerbatimHelp, hide_rare, tell_defaults
from .output import PROGRAM, complain

TYPE_CHECKING = False  # typing alone takes a twentieth of what --version may
if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from typing import Any, NoReturn

__all__ = ["COMMANDS", "PROGRAM", "parsed", "parser_of", "whole_parser"]

COMMANDS = {
    "read": ("ask.values", "read registers, coils, records and named points, once or repeatedly"),
    "write": ("ask.values", "write registers, coils, records and named points"),
    "identify": ("ask.reports", "print the identification of a device"),
    "diagnose": ("ask.reports", "print the counters, event log and status of a device"),
    "raw": ("ask.reports", "send any function code, and print the response"),
    "scan": ("find.scan", "find the units on a line or behind an address, and their settings"),
    "ports": ("find.ports", "list the serial ports of this machine"),
    "sunspec": ("find.sunspec", "print the SunSpec models of a device, and their values"),
    "map": ("ask.map", "check register maps, or make one by reading a device"),
    "listen": ("find.listen", "print the traffic between other devices on a line"),
    "serve": ("serve.serve", "simulate devices that a device file describes"),
    "gateway": ("serve.gateway", "forward requests from clients to devices on other lines"),
    "poll": (
        "serve.poll",
        "poll many devices, and write the readings to files, MQTT or Prometheus",
    ),
    "fleet": ("serve.fleet", "print the status of the workers that poll a fleet together"),
    "certificates": ("certificates", "make certificates for trying Modbus Security (tls://)"),
    "completion": ("completion", "print the completion script for bash, zsh or fish"),
    "demo": ("demo", "show a client and a server talking over three kinds of lines"),
}
"""Name -> module in this package, and the purpose."""

EXAMPLES = """\
examples:
  libmodbus-py serve --example meter
  libmodbus-py scan /dev/ttyUSB0
  libmodbus-py 192.0.2.10 hr 0 10                  # read, which may be left out
  libmodbus-py read /dev/ttyUSB0 -b 9600 -u 7 --map meter.csv --watch"""


def parsed(arguments: Sequence[str]) -> argparse.Namespace:
    """
    Return the arguments of the command; ``run``, which runs the command with them; and
    ``parser``, whose ``error`` prints a message and exits.
    """
    if arguments and arguments[0] not in COMMANDS and _is_read(arguments):
        arguments = ["read", *arguments]
    # Options before the command have no values, so the first word must be the command.
    if not arguments or arguments[0] not in COMMANDS:
        names = whole_parser(())
        names.parse_args(arguments)
        names.error("COMMAND must come first")
    name, *others = arguments
    parser = parser_of(name)
    from .arguments import with_forms
    from .foreign import equivalents

    if any(action.nargs == argparse.PARSER for action in parser._actions):
        found, unknown = parser.parse_known_args(others)  # its actions have their own parsers
    else:  # options may be anywhere between the words
        if message := equivalents(parser, others):
            parser.error(message)
        found, unknown = parser.parse_known_intermixed_args(with_forms(parser, others))
    if unknown:
        from ..protocol.mistakes import close_to

        flags = found.parser._option_string_actions
        option = next((word for word in unknown if word.startswith("-")), "").partition("=")[0]
        close = close_to(option[2:], [each[2:] for each in flags if each[:2] == "--"], "--")
        found.parser.error(f"unrecognized arguments: {' '.join(unknown)}{close}")
    return found


def _is_read(arguments: Sequence[str]) -> bool:
    """Return True if a device stands where a command should: then it is read."""
    from .foreign import is_place

    if arguments[0].startswith("-"):
        is_asked = arguments[0] in ("-h", "--help", "--help-all", "--version")
        return not is_asked and any(map(is_place, arguments))
    return is_place(arguments[0])


def parser_of(name: str) -> _Parser:
    """Import the file of a command, and return the parser."""
    about = COMMANDS[name][1]
    parser = _Parser(prog=f"{PROGRAM} {name}", description=f"{about[0].upper()}{about[1:]}.")
    _fill(parser, name)
    return parser


def _fill(parser: argparse.ArgumentParser, name: str) -> None:
    import_module(f".{COMMANDS[name][0]}", __package__).add_command(_Wanted(parser, name))
    parser.set_defaults(parser=parser)


class _Wanted:
    """Looks like the subparsers of argparse to `add_command`, and fills the parser of a command."""

    def __init__(self, parser: argparse.ArgumentParser, name: str) -> None:
        self._parser = parser
        self.name = name

    def add_parser(self, name: str, **texts: Any) -> argparse.ArgumentParser:
        for attribute, text in texts.items():
            setattr(self._parser, attribute, text)
        return self._parser


def whole_parser(filled: Collection[str]) -> argparse.ArgumentParser:
    """Return a parser that knows all commands, and the arguments of `filled`, which it imports."""
    parser = _Parser(
        prog=PROGRAM,
        description="Modbus clients, servers and tools, based on libmodbus.",
        epilog=f"{PROGRAM} COMMAND --help shows the arguments of a command.\n\n{EXAMPLES}",
        formatter_class=VerbatimHelp,
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for name, (_, about) in COMMANDS.items():
        command = commands.add_parser(name, help=about)
        if name in filled:
            _fill(command, name)
    return parser


class _Parser(argparse.ArgumentParser):
    shows_all: bool = False  # whether the help contains rare options

    def __init__(self, **options: Any) -> None:
        # The beginning of an option is refused: --count would be taken for --count-from-1.
        super().__init__(**{"formatter_class": Help, "allow_abbrev": False, **options})
        # argparse would take -1e5 and -inf for options.
        self.add_argument("--help-all", action=HelpAll, nargs=0)
        self.color = False  # of newer versions of Python
        self._negative_number_matcher = re.compile(r"-(\.?[0-9]|inf|nan)", re.IGNORECASE)

    def format_help(self) -> str:
        tell_defaults(self)
        hide_rare(self, shows_all=self.shows_all)
        return super().format_help()

    def _print_message(self, message: str, file: Any = None) -> None:
        # argparse would ignore a full disk.
        file.write(message)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse a word that is not a choice, and name a close one."""
        if action.choices is None or value in action.choices:
            return
        from ..protocol.mistakes import close_to

        close = close_to(value, action.choices)
        if action.nargs == argparse.PARSER and (close or self.prog == PROGRAM):
            device = f"; a device of this name is read by {PROGRAM} read {value}"
            raise argparse.ArgumentError(None, f"there is no command {value!r}{close or device}")
        known = ", ".join(map(str, action.choices))
        raise argparse.ArgumentError(action, f"must be one of {known}, not {value!r}{close}")

    def error(self, message: str) -> NoReturn:
        complain(f"{message} (see {self.prog} --help)")
        self.exit(2)
