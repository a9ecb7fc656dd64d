"""
Every command, with its file and its purpose; and the parser of what is typed, with its --help.

The file of a command is imported when the command is typed. Its ``add_command`` declares the
arguments. --help leaves out options that few people need, and --help-all shows them, too.
"""

from __future__ import annotations

import argparse
import os
import re
from importlib import import_module

from ..version import __version__
from .output import PROGRAM, complain

TYPE_CHECKING = False  # typing alone takes a twentieth of what --version may
if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence
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
        if arguments and arguments[0].startswith("-") and arguments[0] not in OF_PROGRAM:
            at = next((at for at, word in enumerate(arguments) if word in COMMANDS), 1)
            name = arguments[at] if arguments[at:] and arguments[at] in COMMANDS else "COMMAND"
            before = " ".join(arguments[:at])
            names.error(f"options stand behind the command: {PROGRAM} {name} {before} ...")
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
        if name == "poll" and not option:
            close = f"; {PROGRAM} read {' '.join(others)} --watch polls without a fleet file"
        found.parser.error(f"unrecognized arguments: {' '.join(unknown)}{close}")
    return found


def _is_read(arguments: Sequence[str]) -> bool:
    """Return True if a device stands where a command should: then it is read."""
    from .foreign import is_place

    if arguments[0].startswith("-"):
        is_of_others = arguments[0] in OF_PROGRAM or not COMMANDS.keys().isdisjoint(arguments)
        return not is_of_others and any(map(is_place, arguments))
    return is_place(arguments[0])


def parser_of(name: str) -> Parser:
    """Import the file of a command, and return the parser."""
    module, about = COMMANDS[name]
    parser = Parser(prog=f"{PROGRAM} {name}", description=f"{about[0].upper()}{about[1:]}.")
    import_module(f".{module}", __package__).add_command(parser)
    return parser


def whole_parser(filled: Collection[str]) -> argparse.ArgumentParser:
    """Return a parser that knows all commands, and the arguments of `filled`, which it imports."""
    parser = Parser(
        prog=PROGRAM,
        description="Modbus clients, servers and tools, based on libmodbus.",
        epilog=f"{PROGRAM} COMMAND --help shows the arguments of a command.\n\n{EXAMPLES}",
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for name, (module, about) in COMMANDS.items():
        command = commands.add_parser(name, help=about)
        if name in filled:
            import_module(f".{module}", __package__).add_command(command)
    return parser


class Parser(argparse.ArgumentParser):
    """The parser of a command, the same in all versions of Python."""

    shows_all: bool = False  # whether the help contains rare options

    def __init__(self, **options: Any) -> None:
        # The beginning of an option is refused: --count would be taken for --count-from-1.
        super().__init__(**{"formatter_class": Help, "allow_abbrev": False, **options})
        self.add_argument("--help-all", action=HelpAll, nargs=0)
        self.set_defaults(parser=self)
        self.color = False  # of newer versions of Python
        # argparse would take -1e5 and -inf for options.
        self._negative_number_matcher = re.compile(r"-(\.?[0-9]|inf|nan)", re.IGNORECASE)

    def format_help(self) -> str:
        """Return the help with default values, and without rare options unless all are shown."""
        groups = [
            [each for each in group._group_actions if getattr(each, "is_rare", False)]
            for group in self._action_groups
        ]
        # A rare option of the first and of the last group.
        names = [group[0].option_strings[0] for group in groups if group]
        some = ", ".join(dict.fromkeys([*names[:1], *names[-1:]]))
        for action in self._actions:
            usual = action.__dict__.pop("usual", dict)().get(action.dest)
            if usual is not None and not isinstance(usual, bool):
                text = f"{usual:g}" if isinstance(usual, float) else usual
                action.help = f"{action.help} ({text})"
            if isinstance(action, HelpAll):
                action.help = f"show rare options, too: {some}, ..." if some else argparse.SUPPRESS
            if getattr(action, "is_rare", False) and not self.shows_all:
                action.help = argparse.SUPPRESS
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
            from .foreign import COMMANDS as FOREIGN

            if (other := FOREIGN.get(value)) and not close:
                close = f"; type {PROGRAM} {other}"
            device = f"; a device of this name is read by {PROGRAM} read {value}"
            raise argparse.ArgumentError(None, f"there is no command {value!r}{close or device}")
        known = ", ".join(map(str, action.choices))
        raise argparse.ArgumentError(action, f"must be one of {known}, not {value!r}{close}")

    def error(self, message: str) -> NoReturn:
        complain(f"{message} (see {self.prog} --help)")
        self.exit(2)


class HelpAll(argparse.Action):
    """The option --help-all."""

    def __call__(self, parser: Any, *_: Any) -> None:
        parser.shows_all = True
        parser.print_help()
        parser.exit()


class Help(argparse.RawDescriptionHelpFormatter):
    """Formats help as wide as the terminal; the usage line names no single options."""

    def __init__(self, prog: str, **options: Any) -> None:
        # argparse asks shutil for the width, which imports three compressors at each start.
        columns = os.environ.get("COLUMNS", "")
        try:
            width = int(columns) if columns.isdecimal() else os.get_terminal_size(1).columns or 80
        except OSError:
            width = 80
        super().__init__(prog, **{"width": width - 2, **options})

    def add_argument(self, action: argparse.Action) -> None:
        super().add_argument(action)
        # As Python 3.13 does: commands count with their indentation.
        for each in self._iter_indented_subactions(action):
            length = len(self._format_action_invocation(each)) + self._current_indent
            self._action_max_length = max(self._action_max_length, length)

    def _format_usage(
        self, usage: Any, actions: Iterable[argparse.Action], groups: Any, prefix: str | None
    ) -> str:
        if usage is not None:  # argparse made it before it hides positional arguments
            return f"usage: {usage.strip()}\n\n"
        actions = list(actions)
        needed = [action for action in actions if action.required or not action.option_strings]
        has_options = any(not action.required and action.option_strings for action in actions)
        words = [self._prog, *["[OPTIONS]"] * has_options, *map(self._usage_of, needed)]
        return f"{'usage: ' if prefix is None else prefix}{' '.join(words)}\n\n"

    def _usage_of(self, action: argparse.Action) -> str:
        if not action.option_strings:
            return self._format_args(action, self._get_default_metavar_for_positional(action))
        return f"{action.option_strings[-1]} {action.metavar}"

    def _format_action_invocation(self, action: argparse.Action) -> str:
        """As newer versions of Python: -u, --unit N."""
        if not action.option_strings or action.nargs == 0:
            return super()._format_action_invocation(action)
        default = self._get_default_metavar_for_optional(action)
        return f"{', '.join(action.option_strings)} {self._format_args(action, default)}"
