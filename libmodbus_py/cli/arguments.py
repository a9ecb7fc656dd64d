"""
Arguments that several commands take, what completes them, and the endpoints and clients that they
make.

Every option of URLs (`ports.schemes`) is an option of the command line under the same name, with
hyphens. Options that are not typed are None, so that the URL or the default applies.

Completers are functions as argcomplete calls them: with the text so far, and the arguments typed.
"""

from __future__ import annotations

import argparse

from ..ports.options import (
    ASCII_DEFAULTS,
    CLIENT_OPTIONS,
    PARITIES,
    SERIAL_DEFAULTS,
    SERIAL_OPTIONS,
)
from ..ports.schemes import SCHEMES, SECURITY_OPTIONS, TRANSPORTS, options_of, shape_of
from .parser import declare

TYPE_CHECKING = False  # see commands
if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
    from typing import Any

    from ..client.blocking import Client
    from ..ports.endpoint import Endpoint
    from ..ports.options import Form, Option
    from .parser import Parser


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
     names of options with _ for -; options override them. Quote URLs with &."""
"""The end of each --help of a client."""

SCHEMES_OF_URLS = _listed(f"{scheme}://" for scheme in SCHEMES)
"""The schemes, for commands that listen."""

SHORT = {"unit": "-u", "baudrate": "-b", "parity": "-p", "data_bits": "-d", "stop_bits": "-s"}

SUFFIXES = (".csv", ".json", ".jsonl", ".ndjson", ".tsv", ".txt", ".log")

OFTEN_USED = {"unit", "timeout", "retries", *SERIAL_DEFAULTS}
"""The options of URLs that --help shows; --help-all shows the others, too."""

REPEATED = ("pin",)
"""Options that may be given several times; a URL has their values with commas between."""

OF_SERVERS = (*SERIAL_OPTIONS, *SECURITY_OPTIONS)
"""The options of URLs that mean something to a server."""

OF_CLIENTS = (*CLIENT_OPTIONS, *OF_SERVERS)
"""The options of URLs that mean something to a client."""


def flag(name: str) -> str:
    """Return the option that sets something, as it is typed: ``--data-bits`` for data_bits."""
    return f"--{name.replace('_', '-')}"


def typed_options(options: argparse.Namespace, names: Collection[str]) -> dict[str, Any]:
    """Return the options that were typed."""
    return {name: value for name in names if (value := getattr(options, name, None)) is not None}


def refuse_options(options: argparse.Namespace, names: Collection[str], why: str) -> None:
    """Raise ValueError if one of some options was typed: with its name, and the reason."""
    if values := typed_options(options, names):
        raise ValueError(f"{flag(next(iter(values)))} {why}")


# --- arguments of several commands --------------------------------------------------------------


URL = "URL\n  such as 192.0.2.10, 192.0.2.10:1502 or /dev/ttyUSB0\n"
"""The declaration of the URL of a device."""


def add_client(command: Parser, *, several: bool = False) -> None:
    declare(command, URL)
    add_requests(command, several=several)


def add_requests(command: Parser, *, several: bool = False) -> None:
    """Add the options of a client, or of a command that asks several units one after the other."""
    group = command.group("requests")
    if several:
        add_units(group, "unit to ask, 0..255, or several, such as 1-9,17 (1)")
    add_client_options(group, without=("unit",) if several else ())
    add_verbose(command)
    add_serial_options(command)
    add_security_options(command)


def add_verbose(command: Parser) -> None:
    declare(command, "-v --verbose\n  print every frame sent and received to stderr")


def add_units(group: Any, text: str) -> None:
    def units(text: str) -> list[int]:
        from ..protocol.plain import units_of

        try:
            return list(dict.fromkeys(units_of(text)))
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    declare(group, f"-u --unit --units LIST\n  {text}", unit={"dest": "units", "type": units})


def add_columns(group: Any, rare: str = "rare ", *, encoding: bool = False) -> None:
    """Add what says how the list of a map is read; with its encoding if nothing else has one."""

    def column(text: str) -> tuple[str, str]:
        key, _, heading = text.partition("=")
        if key and heading:
            return key, heading
        reason = f"must be KEY=HEADING, such as name=Bezeichnung, not {text!r}"
        raise argparse.ArgumentTypeError(reason)

    kinds = {
        "column": {"dest": "columns", "type": column, "default": []},
        "from": {"dest": "origin", "choices": ORIGINS},
        "list": {"dest": "list", "type": _of_list, "default": [], "complete": LIST_KEYS},
        "encoding": {"dest": "list_encoding"},
    }
    for text in OF_LISTS[: 4 if encoding else 3]:
        declare(group, rare + text, **kinds)


# As in list_words.toml, which takes longer to read.
ORIGINS = ("iobroker", "modpoll", "nibe", "victron")

LIST_KEYS = (
    *("access", "encoding", "first_address", "lengths", "only", "order", "sheet", "table"),
    "types",
)

OF_LISTS = (
    """--column KEY=HEADING ...
    the heading of a column of the map that is not recognised, such as name=Bezeichnung; may be
    repeated""",
    """--from ORIGIN
    whose list the map is, and what it means by its words: iobroker, modpoll, nibe or victron""",
    """--list KEY=VALUE ...
    what a list does not say: encoding, first_address, table, access, order, lengths, sheet,
    only=HEADING=CELL, types=WORD=TYPE; may be repeated""",
    "--encoding NAME\n  the encoding of the list, such as cp1252 or gbk (UTF-8)",
)


def _of_list(text: str) -> tuple[str, Any]:
    key, _, value = text.partition("=")
    if key not in LIST_KEYS or not value or (key in ("only", "types") and "=" not in value):
        reason = f"must be KEY=VALUE, with a key of {', '.join(LIST_KEYS)}, not {text!r}"
        raise argparse.ArgumentTypeError(reason)
    word, _, meaning = value.rpartition("=")
    return key, {word: meaning} if key in ("only", "types") else value


def list_keys(options: argparse.Namespace) -> dict[str, Any]:
    """Return what was said of a list, as `load_map` takes it."""
    keys: dict[str, Any] = {}
    for name, value in options.list:
        keys[name] = {**keys.get(name, {}), **value} if isinstance(value, dict) else value
    columns: dict[str, Any] = {}
    for kind, heading in options.columns:
        columns[kind] = [*columns.get(kind, ()), heading] if kind == "nothing" else heading
    settings = {"columns": columns, "origin": options.origin, **keys}
    if encoding := getattr(options, "list_encoding", None):
        settings["encoding"] = encoding
    return {name: value for name, value in settings.items() if value}


class _Form(argparse.Action):
    """Sets the form of output, and the attribute `written_to`: the name of a file, or None."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: Any = None) -> None:
        setattr(namespace, self.dest, True)
        namespace.written_to = values or None


def add_forms(
    command: Any,
    csv: str = "",
    json: str = "print JSON in lines",
    *,
    csv_file: str = "write it to a new FILE",
) -> None:
    """Add --json, and --csv if `text` describes it; with a file, the output is written there."""
    for name, text in (("csv", csv), ("json", json)):
        if text:
            to_file = csv_file if name == "csv" else "write it to a new FILE"
            help = f"--{name} [FILE]\n  {text}, or {to_file}"
            declare(command, help, **{name: {"action": _Form, "const": ""}})


def with_forms(parser: Parser, words: Sequence[str]) -> list[str]:
    """
    Return the words typed, changed so that --csv and --json take only a file as their value.

    The word behind is a file only if its suffix or its beginning says so; a path below /dev is a
    serial port.
    """
    end = words.index("--") if "--" in words else len(words)
    result = [*words]
    for at, word in enumerate(words[:end]):
        following = words[at + 1] if at + 1 < len(words) else ""
        is_path = following.startswith(("/", "./", "../")) and not following.startswith("/dev/")
        is_file = is_path or following.lower().endswith(SUFFIXES)
        if isinstance(parser.flags.get(word), _Form) and not is_file:
            result[at] = f"{word}="
    return result


def add_client_options(
    group: Any, *, without: Collection[str] = (), usual: Callable[[], Mapping[str, Any]] = dict
) -> None:
    """Add the options of clients; `usual` returns texts in place of their default values."""
    defaults = {name: row.default for name, row in CLIENT_OPTIONS.items()}
    _add(group, CLIENT_OPTIONS, lambda: {**defaults, **usual()}, without)


def add_serial_options(command: Parser, *, without: Collection[str] = ()) -> Any:
    """Add the settings of serial ports, and return their group."""
    group = command.group("serial port")
    _add(group, SERIAL_OPTIONS, _of_serial_ports, without)
    return group


def add_security_options(command: Parser) -> None:
    _add(command.group("certificates, for tls://"), SECURITY_OPTIONS)


def _add(
    group: Any,
    options: Mapping[str, Option],
    usual: Callable[[], Mapping[str, Any]] | None = None,
    without: Collection[str] = (),
) -> None:
    for name, option in options.items():
        if name in without:
            continue
        form = option.form
        words = ["" if name in OFTEN_USED else "rare", SHORT.get(name, ""), flag(name)]
        head = " ".join(filter(None, [*words, form.placeholder]))
        more: dict[str, Any] = {"type": read_as(form)}
        if not form.placeholder:
            more = {"action": argparse.BooleanOptionalAction}
        if name in REPEATED:
            more["action"] = "append"
        if name == "parity":
            more["complete"] = PARITY_WORDS
        remark = "; may be repeated" * (name in REPEATED)
        declare(group, f"{head}\n  {option.summary}{remark}", usual, **{name: more})


def read_as(form: Form, separator: str | None = None) -> Callable[[str], Any]:
    """Return the function that converts what is typed: a value, or several with a separator."""

    def read(text: str) -> Any:
        values = []
        for part in text.split(separator) if separator else [text]:
            try:
                values.append(form.convert(part.strip() if separator else part))
            except ValueError:
                which = f"{part!r} must be {form.wanted}"
                text = which if separator else f"must be {form.wanted}, not {text!r}"
                raise argparse.ArgumentTypeError(text) from None
        return values if separator else values[0]

    return read


def _of_serial_ports() -> dict[str, Any]:
    others = {name: value for name, value in ASCII_DEFAULTS.items() if name in SERIAL_DEFAULTS}
    texts = {name: f"{SERIAL_DEFAULTS[name]}; ascii: {value}" for name, value in others.items()}
    words = {letter: word for word, letter in reversed(PARITIES.items())}
    return {**SERIAL_DEFAULTS, **texts, "parity": words[SERIAL_DEFAULTS["parity"]]}


# --- completion of arguments -------------------------------------------------------------------

PARITY_WORDS = [word for word in PARITIES if len(word) > 1]


def lists_of_parities(prefix: str, **_: Any) -> list[str]:
    """Return the words that continue a list of parities that was begun."""
    before, comma, _last = prefix.rpartition(",")
    return [f"{before}{comma}{word}" for word in PARITY_WORDS if word not in before.split(",")]


def names_of_maps(**_: Any) -> list[str]:
    """Return the names of the register maps that come with the package."""
    from ..tools.simulator import example_files

    return [*example_files.maps()]


def maps(prefix: str, **_: Any) -> list[str]:
    """Return the register maps that come with the package, and files."""
    from argcomplete.completers import FilesCompleter

    return [*names_of_maps(), *FilesCompleter((".csv", ".toml"))(prefix)]


# --- endpoints and clients ----------------------------------------------------------------------


def endpoint_of(options: argparse.Namespace) -> Endpoint:
    """Return where to connect: the URL, with the options that were typed."""
    return with_options([options.url], options)[0]


def new_client(options: argparse.Namespace) -> Client:
    """Make the client; it connects when it is used."""
    from ..client.blocking import Client

    hooks: dict[str, Any] = {}
    if options.verbose:
        from .tracing import Tracing

        hooks["trace"] = Tracing()
    return Client(endpoint_of(options).url, **hooks)


def with_options(
    urls: Iterable[str], options: argparse.Namespace, names: Collection[str] = OF_CLIENTS
) -> list[Endpoint]:
    """Return the endpoints of URLs, each with those of the named options that apply to it."""
    from dataclasses import replace

    from ..ports.endpoint import parse

    endpoints = [parse(url) for url in urls]
    values = typed_options(options, names)
    values |= {name: ",".join(values[name]) for name in REPEATED if name in values}
    useful = {name for endpoint in endpoints for name in options_of(endpoint.scheme)}
    for transport, rules in TRANSPORTS.items():
        useless = [name for name in values if name in rules.options and name not in useful]
        if useless:
            kind = "serial ports" if rules.is_serial else f"{transport}:// URLs"
            places = ", ".join(map(str, endpoints))
            raise ValueError(f"{flag(useless[0])} applies to {kind} only, not to {places}")
    client = {name: value for name, value in values.items() if name in CLIENT_OPTIONS}
    result = []
    for endpoint in endpoints:
        own = {name: values[name] for name in options_of(endpoint.scheme) if name in values}
        settings, of_client = {**endpoint.options, **own}, {**endpoint.client_options, **client}
        result.append(replace(endpoint, options=settings, client_options=of_client))
    return result
