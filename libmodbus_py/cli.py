"""
The command line: demo, serve, read, write.

Exit code 0; 1 when the device or the line failed; 2 for wrong usage. Errors are
one line on stderr.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, NoReturn

from . import demo, pdu, url
from .context import Context
from .device import Device
from .errors import ModbusError
from .mapping import Mapping
from .pdu import RECORDS_PER_FILE
from .server import Server
from .values import parse_reference

__all__ = ["main"]

PROGRAM = "libmodbus-py"

TABLES = {
    "coils": "coils",
    "discrete": "discrete_inputs",
    "holding": "holding_registers",
    "input": "input_registers",
    "file": "file",
}
"""What is typed -> the table's name."""

READS: dict[str, Callable[[int, int], pdu.Request[Any]]] = {
    "coils": pdu.ReadCoils,
    "discrete_inputs": pdu.ReadDiscreteInputs,
    "holding_registers": pdu.ReadHoldingRegisters,
    "input_registers": pdu.ReadInputRegisters,
}

BITS = {"0": False, "1": True, "off": False, "on": True, "false": False, "true": True}


class Place(NamedTuple):
    """A run of items: the table, its first address, and the words that followed."""

    table: str
    file: int
    address: int
    rest: list[str]


def main(arguments: Sequence[str] | None = None) -> int:
    """
    Run the command line.

    Args:
        arguments: without the program's name; None for those of the process.

    Returns:
        The exit code.
    """
    parser = _parser()
    options = parser.parse_args(arguments)
    try:
        code: int = options.run(options)
    except ModbusError as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        return 1
    except (ValueError, TypeError) as error:
        parser.error(str(error))
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # The reader of our output has gone, as `head` does; nothing is left to say.
        sys.stderr.close()
        return 1
    return code


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{PROGRAM}: {message} (see {PROGRAM} --help)\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog=PROGRAM, description="Modbus on libmodbus: try, serve, read, write.")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    command = commands.add_parser("demo", help="watch a client and a server talk on three lines")
    command.set_defaults(run=lambda options: demo.run())

    command = commands.add_parser(
        "serve",
        help="serve all tables and ten files, all zero, to every unit",
        epilog=f"URLs: {' '.join(f'{scheme}://...' for scheme in url.SCHEMES)}",
    )
    command.add_argument("urls", metavar="URL", nargs="+", help="such as tcp://127.0.0.1:1502")
    command.set_defaults(run=_serve)

    where = "TABLE ADDRESS (coils, discrete, holding, input, file:N; from 0) or a reference (40123)"
    command = commands.add_parser("read", help="read a table", description=f"WHERE: {where}")
    _add_client_arguments(command)
    command.add_argument("where", metavar="WHERE", nargs="+", help="where, and how many (1)")
    command.add_argument("--json", action="store_true", help="print one line of JSON")
    command.set_defaults(run=_read)

    command = commands.add_parser("write", help="write a table", description=f"WHERE: {where}")
    _add_client_arguments(command)
    command.add_argument("where", metavar="WHERE VALUE", nargs="+", help="where, and the values")
    command.set_defaults(run=_write)
    return parser


def _add_client_arguments(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "url", metavar="URL", help="such as tcp://192.0.2.10 or rtu:///dev/ttyUSB0"
    )
    command.add_argument("--unit", type=int, default=1, metavar="N", help="0..255 (1)")
    command.add_argument("--timeout", type=float, default=1.0, metavar="S", help="seconds (1)")


def _place(words: list[str]) -> Place:
    """Read ``TABLE ADDRESS REST...`` or ``REFERENCE REST...``."""
    first, *rest = words
    name, _, file = first.partition(":")
    if name not in TABLES:
        if not first.isdigit():
            raise ValueError(f"{first!r} must be one of {', '.join(TABLES)}, or such as 40123")
        table, address = parse_reference(first)
        if table == "file":
            raise ValueError(f"{first!r} lacks the file's number: write file:N {address}")
        return Place(table, 0, address, rest)
    if (name == "file") != bool(file):
        raise ValueError(f"{first!r}: a file, and only a file, has a number, as in file:4")
    if not rest:
        raise ValueError(f"{first} lacks an address")
    number = _number("file", file) if file else 0
    return Place(TABLES[name], number, _number("address", rest[0]), rest[1:])


def _number(name: str, text: str) -> int:
    try:
        return int(text, 0)
    except ValueError:
        raise ValueError(f"{name} must be a number, not {text!r}") from None


def _context(options: argparse.Namespace) -> Context:
    return Context.from_url(options.url, unit=options.unit, timeout=options.timeout)


# --- read ----------------------------------------------------------------------------


def _read(options: argparse.Namespace) -> int:
    place = _place(options.where)
    if len(place.rest) > 1:
        raise ValueError(f"{' '.join(place.rest[1:])!r} after the count means nothing")
    count = _number("count", place.rest[0]) if place.rest else 1
    request: pdu.Request[Any]
    if place.table == "file":
        request = pdu.ReadFileRecords(((place.file, place.address, count),))
    else:
        request = READS[place.table](place.address, count)
    with _context(options) as context:
        result = context.execute(request)
    values = [int(value) for value in (result[0] if place.table == "file" else result)]
    _print_values(options, place, values)
    return 0


def _print_values(options: argparse.Namespace, place: Place, values: list[int]) -> None:
    if options.json:
        found = {"unit": options.unit, "table": place.table, "address": place.address}
        if place.table == "file":
            found["file"] = place.file
        print(json.dumps({**found, "values": values}))
        return
    width = len(str(max(values)))
    for address, value in enumerate(values, start=place.address):
        print(f"{address:>5}  {value:>{width}}")


# --- write ---------------------------------------------------------------------------


def _write(options: argparse.Namespace) -> int:
    place = _place(options.where)
    if not place.rest:
        raise ValueError("there is no value to write")
    request = _write_request(place)
    with _context(options) as context:
        context.execute(request)
    return 0


def _write_request(place: Place) -> pdu.Request[Any]:
    if place.table in ("discrete_inputs", "input_registers"):
        raise ValueError(f"{place.table.replace('_', ' ')} can only be read")
    if place.table == "coils":
        bits = tuple(_bit(text) for text in place.rest)
        if len(bits) == 1:
            return pdu.WriteCoil(place.address, bits[0])
        return pdu.WriteCoils(place.address, bits)
    values = tuple(_register(text) for text in place.rest)
    if place.table == "file":
        return pdu.WriteFileRecords(((place.file, place.address, values),))
    if len(values) == 1:
        return pdu.WriteRegister(place.address, values[0])
    return pdu.WriteRegisters(place.address, values)


def _bit(text: str) -> bool:
    try:
        return BITS[text.lower()]
    except KeyError:
        raise ValueError(f"value must be one of {', '.join(BITS)}, not {text!r}") from None


def _register(text: str) -> int:
    """Signed and unsigned are the same 16 bits."""
    value = _number("value", text)
    if not -0x8000 <= value <= 0xFFFF:
        raise ValueError(f"value must be in -32768..65535, not {value}")
    return value & 0xFFFF


# --- serve ---------------------------------------------------------------------------


def _serve(options: argparse.Namespace) -> int:
    everything = Mapping(65536, 65536, 65536, 65536)
    files = {number: [0] * RECORDS_PER_FILE for number in range(1, 11)}
    asyncio.run(_serve_until_signal(Server(Device(everything, files=files)), options.urls))
    return 0


async def _serve_until_signal(server: Server, urls: list[str]) -> None:
    stopped = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stopped.set)
    async with server.serving(*urls) as running:
        for address in running.urls:
            print(f"listening on {address}", flush=True)
        await stopped.wait()
