"""
The arguments that several commands take, each declared once, and the words that complete them.

Every option of URLs (`ports.schemes`) is an option of the command line under the same name, with
hyphens. Options that are not typed are None, so that the URL or the default applies.

Completers are functions as argcomplete calls them: with the text so far, and the arguments typed.
"""

from __future__ import annotations

import argparse

from ..ports.schemes import (
    CLIENT_OPTIONS,
    OTHER_NAMES,
    PARITIES,
    SCHEMES,
    SECURITY_OPTIONS,
    SERIAL_OPTIONS,
    shape_of,
)
from .foreign import place
from .help import VerbatimHelp, make_rare

TYPE_CHECKING = False  # see commands
if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
    from typing import Any

    from ..ports.schemes import Option

# fmt: off
__all__ = [
    "REPEATED", "SCHEMES_OF_URLS", "URLS", "add_client", "add_client_options", "add_columns",
    "add_csv", "add_defaults", "add_json", "add_requests", "add_security_options",
    "add_serial_options", "add_units", "add_url", "add_verbose", "completing",
    "examples", "flag", "given", "lists_of_parities", "maps", "names_of_maps", "with_forms",
]
# fmt: on


def _listed(shapes: Iterable[str]) -> str:
    """Return an enumeration of URLs in lines of at most 79 characters."""
    lines = ["URL:"]
    for word in f"{', '.join(shapes)}; or just HOST, HOST:PORT or /dev/ttyUSB0.".split():
        if len(lines[-1]) + 1 + len(word) > 79:
            lines.append("    ")
        lines[-1] += f" {word}"
    return "\n".join(lines)


URLS = f"""\
{_listed(shape_of(scheme) for scheme in SCHEMES)}
     Settings follow ?, as in "tcp://192.0.2.10?unit=7&timeout=2", under the
     names of options, with _ in place of -; an option overrides them. Quote
     such a URL, because shells interpret &."""
"""The end of each --help of a client."""

SCHEMES_OF_URLS = _listed(f"{scheme}://" for scheme in SCHEMES)
"""The schemes, for commands that listen."""

SHORT = {"unit": "-u", "baudrate": "-b", "parity": "-p", "data_bits": "-d", "stop_bits": "-s"}

SUFFIXES = (".csv", ".json", ".jsonl", ".ndjson", ".tsv", ".txt", ".log")

RARE = {
    *("busy_retries", "max_in_flight", "turnaround", "request_spacing", "connect_delay"),
    *("timeouts_before_reconnect", "keepalive", "max_pause", "native", "accept_unit", "delimiter"),
    *("rs485", "rts_delay", "echo", "silence", *SECURITY_OPTIONS),
}
"""Options that --help leaves out."""

REPEATED = ("pin",)
"""Options that may be given several times; a URL has their values with commas between."""


def flag(name: str) -> str:
    """Return the option that sets something, as it is typed: ``--data-bits`` for data_bits."""
    return f"--{name.replace('_', '-')}"


def given(options: argparse.Namespace, names: Collection[str]) -> dict[str, Any]:
    """Return the options that were typed."""
    return {name: value for name in names if (value := getattr(options, name, None)) is not None}


# --- single arguments ---------------------------------------------------------------------------


def add_url(command: argparse.ArgumentParser) -> None:
    """Add the URL of a device."""
    command.formatter_class = VerbatimHelp
    command.add_argument(
        "url", type=place, metavar="URL", help="such as 192.0.2.10, 192.0.2.10:1502 or /dev/ttyUSB0"
    )


def add_verbose(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "-v", "--verbose", action="store_true", help="print every frame sent and received to stderr"
    )


def add_json(group: Any, text: str = "print JSON in lines") -> None:
    """Add --json; with the name of a file the output is written there."""
    _add_form(group, "--json", text)


def add_csv(group: Any) -> None:
    """Add --csv; with the name of a file the output is written there."""
    _add_form(group, "--csv", "print CSV")


def _add_form(group: Any, name: str, text: str) -> None:
    text += ", or write it to a new FILE"
    group.add_argument(name, action=_Form, nargs="?", const="", metavar="FILE", help=text)


class _Form(argparse.Action):
    """Sets the form of output, and the attribute `written_to`: the name of a file, or None."""

    def __call__(
        self, parser: Any, namespace: argparse.Namespace, values: Any, option_string: Any = None
    ) -> None:
        setattr(namespace, self.dest, True)
        namespace.written_to = values or None


def with_forms(parser: argparse.ArgumentParser, words: Sequence[str]) -> list[str]:
    """
    Return the words typed, changed so that --csv and --json take only a file as their value.

    The word behind is a file only if its suffix or its beginning says so; a path below /dev is a
    serial port.
    """
    options = parser._option_string_actions
    end = words.index("--") if "--" in words else len(words)
    found = [*words]
    for at, word in enumerate(words[:end]):
        following = words[at + 1] if at + 1 < len(words) else ""
        is_path = following.startswith(("/", "./", "../")) and not following.startswith("/dev/")
        is_file = is_path or following.lower().endswith(SUFFIXES)
        if isinstance(options.get(word), _Form) and not is_file:
            found[at] = f"{word}="
    return found


def add_columns(group: Any) -> argparse.Action:
    """Add the headings of columns of register maps in CSV."""
    action: argparse.Action = group.add_argument(
        "--column",
        dest="columns",
        action="append",
        type=_column,
        default=[],
        metavar="KEY=HEADING",
        help="the heading of a column of the map that is not recognised, such as"
        " name=Bezeichnung; may be repeated",
    )
    return action


def _column(text: str) -> tuple[str, str]:
    key, _, heading = text.partition("=")
    if key and heading:
        return key, heading
    raise argparse.ArgumentTypeError(f"must be KEY=HEADING, such as name=Bezeichnung, not {text!r}")


def _read_as(option: Option) -> Callable[[str], Any]:
    """Return the function that converts what is typed, for argparse."""

    def read(text: str) -> Any:
        try:
            return option.convert(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"must be {option.wanted}, not {text!r}") from None

    return read


# --- groups of options --------------------------------------------------------------------------


def add_client(command: argparse.ArgumentParser, *, several: bool = False) -> None:
    """Add what a client takes, or one that asks several units, one after the other."""
    add_url(command)
    add_requests(command, several=several)


def add_requests(command: argparse.ArgumentParser, *, several: bool = False) -> None:
    """Add the options of `add_client`, for a command whose own groups come before them."""
    group = command.add_argument_group("requests")
    if several:
        add_units(group, "unit to ask, 0..255, or several, such as 1-9,17 (1)")
    add_client_options(group, without=("unit",) if several else ())
    add_verbose(command)
    add_serial_options(command)
    add_security_options(command)


def add_units(group: Any, text: str) -> None:
    """Add -u with a list of units."""
    group.add_argument(
        "-u", "--unit", "--units", dest="units", type=_units, metavar="LIST", help=text
    )


def _units(text: str) -> list[int]:
    from ..protocol.plain import units_of

    try:
        return list(dict.fromkeys(units_of(text)))
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def add_client_options(
    group: Any, *, without: Collection[str] = (), defaults: Callable[[], Mapping[str, str]] = dict
) -> None:
    """Add the options of clients; `defaults` returns texts in place of the defaults of clients."""
    options = {name: each for name, each in CLIENT_OPTIONS.items() if name not in without}
    added = _add(group, options)
    add_defaults(added, lambda: {**_of_clients(), **defaults()})


def add_serial_options(command: argparse.ArgumentParser, *, without: Collection[str] = ()) -> Any:
    """Add the settings of serial ports, and return their group."""
    group = command.add_argument_group("serial port")
    options = {name: each for name, each in SERIAL_OPTIONS.items() if name not in without}
    add_defaults(_add(group, options), _of_serial_ports)
    return group


def add_security_options(command: argparse.ArgumentParser) -> None:
    """Add the files that tls:// needs."""
    _add(command.add_argument_group("certificates, for tls://"), SECURITY_OPTIONS)


def _add(group: Any, options: Mapping[str, Option]) -> list[argparse.Action]:
    added: list[argparse.Action] = []
    for name, option in options.items():
        flags = [*filter(None, [SHORT.get(name)]), flag(name)]
        flags += [flag(other) for other, known in OTHER_NAMES.items() if known == name]
        others: dict[str, Any] = {"dest": name, "help": option.text}
        if not option.placeholder:
            others["action"] = argparse.BooleanOptionalAction
        else:
            others |= {"metavar": option.placeholder, "type": _read_as(option)}
        if name in REPEATED:
            others |= {"action": "append", "help": f"{option.text}; may be repeated"}
        added.append(group.add_argument(*flags, **others))
        if name in RARE:
            make_rare(added[-1])
        if name == "parity":
            completing(added[-1], PARITY_WORDS)
    return added


# --- defaults -----------------------------------------------------------------------------------


def add_defaults(actions: list[argparse.Action], defaults: Callable[[], Mapping[str, Any]]) -> None:
    """Make --help add default values, by the names of options; `defaults` is called only then."""
    for action in actions:
        action.usual = lambda name: defaults().get(name)  # type: ignore[attr-defined]


def _of_clients() -> dict[str, Any]:
    from dataclasses import fields

    from ..client.options import CheckedOptions

    return {each.name: each.default for each in fields(CheckedOptions)}


def _of_serial_ports() -> dict[str, Any]:
    from ..ports.schemes import ASCII_DEFAULTS, SERIAL_DEFAULTS

    others = {name: value for name, value in ASCII_DEFAULTS.items() if name in SERIAL_DEFAULTS}
    told = {name: f"{SERIAL_DEFAULTS[name]}; ascii: {value}" for name, value in others.items()}
    words = {letter: word for word, letter in reversed(PARITIES.items())}
    return {**SERIAL_DEFAULTS, **told, "parity": words[SERIAL_DEFAULTS["parity"]]}


# --- what completes arguments ------------------------------------------------------------------

PARITY_WORDS = [word for word in PARITIES if len(word) > 1]


def completing(
    action: argparse.Action, completer: Iterable[str] | Callable[..., Iterable[str]]
) -> argparse.Action:
    """Set the words that complete an argument, or a function of them; return the argument."""
    found = completer if callable(completer) else lambda **_: completer
    action.completer = found  # type: ignore[attr-defined]
    return action


def lists_of_parities(prefix: str, **_: Any) -> list[str]:
    """Return the words that continue a list of parities that was begun."""
    before, comma, _last = prefix.rpartition(",")
    return [f"{before}{comma}{each}" for each in PARITY_WORDS if each not in before.split(",")]


def examples(**_: Any) -> list[str]:
    """Return the device files that come with the package."""
    from ..tools.simulator.example_files import DEVICES

    return [*DEVICES]


def names_of_maps(**_: Any) -> list[str]:
    """Return the names of the register maps that come with the package."""
    from ..tools.simulator import example_files

    return [*example_files.maps()]


def maps(prefix: str, **_: Any) -> list[str]:
    """Return the register maps that come with the package, and files."""
    from argcomplete.completers import FilesCompleter

    return [*names_of_maps(), *FilesCompleter((".csv", ".toml"))(prefix)]
