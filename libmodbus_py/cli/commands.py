"""
Every command: its name, its file and what it is for; and the parser of what is typed.

A command costs nothing until it is asked for: its file is imported then, and tells argparse of
it with ``add_command``.
"""

from __future__ import annotations

import argparse
import re
from importlib import import_module

from ..version import __version__
from .help import Help

TYPE_CHECKING = False  # typing alone takes a twentieth of what --version may
if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from typing import Any, NoReturn

__all__ = ["COMMANDS", "PROGRAM", "parsed", "parser_of", "whole_parser"]

PROGRAM = "libmodbus-py"

COMMANDS = {
    "read": ("ask.read", "read tables, values and names, once or again and again"),
    "write": ("ask.write", "write tables, values and names, or show what would be sent"),
    "identify": ("ask.identify", "ask what a device is"),
    "diagnose": ("ask.diagnose", "ask how a device and its line are: counters, events, status"),
    "raw": ("ask.raw", "send any function, and show what comes back"),
    "scan": ("find.scan", "find the units that answer, and at which settings of a serial port"),
    "map": ("ask.map", "check register maps; or make one of what a device has"),
    "listen": ("find.listen", "show what others say on a line"),
    "serve": (
        "serve.serve",
        "serve a device file; or all tables and ten files, all zero, to every unit",
    ),
    "gateway": ("serve.gateway", "pass requests on from any endpoint to the devices of any line"),
    "poll": (
        "serve.poll",
        "poll a fleet of devices, and give what is read to files, MQTT, Prometheus",
    ),
    "fleet": ("serve.fleet", "say what the workers do that poll a fleet on several machines"),
    "certificates": ("certificates", "make certificates to try Modbus Security (tls://) with"),
    "completion": ("completion", "print what bash, zsh or fish need to complete all this"),
    "demo": ("demo", "watch a client and a server talk on three lines"),
}
"""Name -> the file here that has it, and what it is for."""


def parsed(arguments: Sequence[str]) -> argparse.Namespace:
    """
    Read what was typed.

    Returns:
        What the command takes; ``run``, which runs it with that; and ``parser``, whose
        ``error`` says what was wrong, and ends.

    Raises:
        SystemExit: --help or --version was asked for, with 0; wrong usage, with 2.
    """
    # Only what comes first can be a command: what is before it has no values.
    if not arguments or arguments[0] not in COMMANDS:
        names = whole_parser(())
        names.parse_args(arguments)
        names.error("COMMAND must come first")
    name, *others = arguments
    parser = parser_of(name)
    if any(action.nargs == argparse.PARSER for action in parser._actions):
        return parser.parse_args(others)  # its actions have parsers of their own
    return parser.parse_intermixed_args(others)  # options may stand anywhere between the words


def parser_of(name: str) -> argparse.ArgumentParser:
    """Make the parser of a command, whose file is imported for it."""
    about = COMMANDS[name][1]
    parser = _Parser(prog=f"{PROGRAM} {name}", description=f"{about[0].upper()}{about[1:]}.")
    _fill(parser, name)
    return parser


def _fill(parser: argparse.ArgumentParser, name: str) -> None:
    import_module(f".{COMMANDS[name][0]}", __package__).add_command(_Wanted(parser))
    parser.set_defaults(parser=parser)


class _Wanted:
    """What `add_command` of each file is given: as argparse has it for several commands."""

    def __init__(self, parser: argparse.ArgumentParser) -> None:
        self._parser = parser

    def add_parser(self, name: str, **texts: Any) -> argparse.ArgumentParser:
        for attribute, text in texts.items():
            setattr(self._parser, attribute, text)
        return self._parser


def whole_parser(filled: Collection[str] = COMMANDS) -> argparse.ArgumentParser:
    """
    Make one that knows the names of all commands.

    Args:
        filled: those whose options it knows, too; their files are imported.
    """
    parser = _Parser(
        prog=PROGRAM,
        description="Modbus on libmodbus: try, serve, read, write, listen.",
        epilog=f"{PROGRAM} COMMAND --help says what a command takes",
    )
    if len(filled) > 1:  # for a manual, where the ends of the single commands are missing
        from .connecting import URLS

        parser.epilog = URLS
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for name, (_, about) in COMMANDS.items():
        command = commands.add_parser(name, help=about)
        if name in filled:
            _fill(command, name)
    return parser


class _Parser(argparse.ArgumentParser):
    def __init__(self, **options: Any) -> None:
        super().__init__(**{"formatter_class": Help, **options})
        # argparse's own takes -1e5 and -inf for options.
        self._negative_number_matcher = re.compile(r"-(\.?[0-9]|inf|nan)", re.IGNORECASE)

    def _print_message(self, message: str, file: Any = None) -> None:
        # argparse's own says nothing of a full disk.
        file.write(message)

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{PROGRAM}: {message} (see {self.prog} --help)\n")
