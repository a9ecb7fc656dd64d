"""
Every command, with its file and its purpose; and the arguments that are typed.

The file of a command is imported when the command is typed. Its ``add_command`` declares the
arguments.
"""

from __future__ import annotations

import argparse
from importlib import import_module

from ..version import __version__
from .output import PROGRAM
from .parser import Parser, Printing, declare, shield_negatives

TYPE_CHECKING = False  # importing typing would take a twentieth of the time of --version
if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

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
    "certificates": (
        "certificates",
        "make, list, renew and revoke certificates for Modbus Security (tls://)",
    ),
    "token": ("token", "make a token for the live page of a command (--page-token)"),
    "completion": ("completion", "print the completion script for bash, zsh or fish"),
    "demo": ("demo", "show a client and a server talking over three kinds of lines"),
}
"""Name -> module in this package, and the purpose."""

OF_PROGRAM = ("-h", "--help", "--help-all", "--version")
"""Options without a command."""

EXAMPLES = """\
examples:
  libmodbus-py serve --example meter
  libmodbus-py scan /dev/ttyUSB0
  libmodbus-py 192.0.2.10 hr 0 10                  # read, which may be left out
  libmodbus-py read /dev/ttyUSB0 -b 9600 -u 7 --map meter.csv --watch"""


def parse_arguments(arguments: Sequence[str]) -> argparse.Namespace:
    """
    Return the arguments of the command; ``run``, which runs the command with them; and
    ``parser``, whose ``error`` prints a message and exits.
    """
    if arguments and arguments[0] not in COMMANDS and _is_read(arguments):
        arguments = ["read", *arguments]
    # Options before the command have no values, so the first word must be the command.
    if not arguments or arguments[0] not in COMMANDS:
        names = whole_parser(())
        if arguments and arguments[0].startswith("-") and arguments[0] not in OF_PROGRAM:
            at = next((at for at, word in enumerate(arguments) if word in COMMANDS), 1)
            name = arguments[at] if arguments[at:] and arguments[at] in COMMANDS else "COMMAND"
            before = " ".join(arguments[:at])
            names.error(f"options stand behind the command: {PROGRAM} {name} {before} ...")
        if arguments and arguments[0] not in OF_PROGRAM:
            names.refuse_command(arguments[0])
        names.parse_args(arguments)
        names.error("COMMAND must come first")
    name, *others = arguments
    parser = parser_of(name)
    from .arguments import with_forms
    from .foreign import equivalents

    if parser.commands:  # commands of this parser have their own parsers
        if others and not others[0].startswith("-") and others[0] not in parser.commands:
            parser.refuse_command(others[0])
        result, unknown = parser.parse_known_args(shield_negatives(others))
    else:  # options may be anywhere between the words
        if message := equivalents(name, parser.flags, others):
            parser.error(message)
        words = shield_negatives(with_forms(parser, others))
        result, unknown = parser.parse_known_intermixed_args(words)
    if unknown:
        from ..protocol.mistakes import close_to

        flags = result.parser.flags
        option = next((word for word in unknown if word.startswith("-")), "").partition("=")[0]
        close = close_to(option[2:], [flag[2:] for flag in flags if flag[:2] == "--"], "--")
        if name == "poll" and not option:
            close = f"; {PROGRAM} read {' '.join(others)} --watch polls without a fleet file"
        result.parser.error(f"unrecognized arguments: {' '.join(map(str.strip, unknown))}{close}")
    return result


def _is_read(arguments: Sequence[str]) -> bool:
    """Return True if the first word is a device, not a command: the command is then read."""
    from .foreign import is_place

    if arguments[0].startswith("-"):
        is_of_others = arguments[0] in OF_PROGRAM or not COMMANDS.keys().isdisjoint(arguments)
        return not is_of_others and any(map(is_place, arguments))
    return is_place(arguments[0])


def parser_of(name: str) -> Parser:
    module, about = COMMANDS[name]
    parser = Parser(prog=f"{PROGRAM} {name}", description=f"{about[0].upper()}{about[1:]}.")
    import_module(f".{module}", __package__).add_command(parser)
    return parser


def whole_parser(names: Collection[str]) -> Parser:
    """Return a parser that knows all commands, and the arguments of `filled`, which it imports."""
    parser = Parser(
        prog=PROGRAM,
        description="Modbus clients, servers and tools, based on libmodbus.",
        epilog=f"{PROGRAM} COMMAND --help shows the arguments of a command.\n\n{EXAMPLES}",
    )
    version = {"action": Printing, "text": lambda _: f"{PROGRAM} {__version__}\n"}
    declare(parser, "--version\n  show program's version number and exit", version=version)
    add = parser.add_commands("COMMAND")
    for name, (module, about) in COMMANDS.items():
        command = add(name, about)
        if name in names:
            import_module(f".{module}", __package__).add_command(command)
    return parser
