"""
The command listen: what others say on a line, one line for each transaction.
"""

from __future__ import annotations

import argparse
import dataclasses
import enum
import json
import logging
import os
import reprlib
import signal
import sys
import time
from typing import Any

from ...protocol.errors import ExceptionResponse
from ...protocol.pdu import Request
from ...tools.listener.listener import Listener, listen
from ...tools.listener.transaction import Transaction
from ..connecting import url_of
from ..help import VerbatimHelp

__all__ = ["add_command"]

COLOURS = {"answered": "", "broadcast": "", "late": "33", "exception": "33"}
"""Kind -> colour of a terminal; all others are red."""

REPEATED = "33"

_shown = reprlib.Repr()
_shown.maxlist = _shown.maxtuple = _shown.maxdict = 16
_shown.maxstring = _shown.maxother = 200


EXAMPLES = """\
examples:
  libmodbus-py listen /dev/ttyUSB0
  libmodbus-py listen "rtu:///dev/ttyUSB0?baudrate=9600&parity=N" --capture line.pcapng
  libmodbus-py listen rtu+tcp://127.0.0.1:1502 --between rtu+tcp://192.0.2.10:502 --json
  libmodbus-py listen line.pcapng

URL: rtu:///dev/ttyUSB0?baudrate=19200&parity=E or ascii:///dev/...; or just /dev/ttyUSB0;
     rtu+tcp://HOST:PORT or ascii+tcp://HOST:PORT with --between; or the path of a capture.
     In quotes where there is an &, which has a meaning in a shell."""


def add_command(commands: Any) -> None:
    """Tell argparse of it."""
    command = commands.add_parser(
        "listen",
        description="Shows every transaction on a line, and a summary after Ctrl-C.",
        epilog=EXAMPLES,
        formatter_class=VerbatimHelp,
    )
    command.add_argument("url", metavar="URL", help="where to listen; FILE.pcapng reads a capture")
    command.add_argument(
        "--between", metavar="URL", help="the device: pass on what clients send, and its answers"
    )
    command.add_argument("--capture", metavar="FILE.pcapng", help="write a capture for Wireshark")
    command.add_argument("--json", action="store_true", help="print one line of JSON for each")
    command.set_defaults(run=_listen)


def _listen(options: argparse.Namespace) -> int:
    logging.basicConfig(format="%(message)s", level=logging.WARNING)  # to stderr
    write = _print_json if options.json else _print_line
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with listen(_place(options.url), between=options.between, capture=options.capture) as line:
            _write_all(line, write, is_live=not options.url.endswith(".pcapng"))
            if options.json:
                print(json.dumps({"summary": line.summary.as_dict()}), flush=True)
            else:
                print(line.summary, flush=True)
    finally:
        signal.signal(signal.SIGTERM, before)
    return 0


def _place(typed: str) -> str:
    """What has no scheme is a capture, unless it is a device."""
    return url_of(typed) if typed.startswith("/dev/") else typed


def _write_all(line: Listener, write: Any, *, is_live: bool) -> None:
    """Until the end of a capture, or Ctrl-C."""
    try:
        if is_live:  # within the block: who reads this line may interrupt at once
            print(f"listening on {line.url}", file=sys.stderr, flush=True)
        for transaction in line:
            write(transaction)
    except KeyboardInterrupt:
        if sys.stdout.isatty():
            print()  # behind the ^C
        for transaction in line.rest():
            write(transaction)


# --- a line for each -----------------------------------------------------------------------


def _print_line(transaction: Transaction) -> None:
    print(line_of(transaction), flush=True)


def line_of(transaction: Transaction) -> str:
    seconds, part = divmod(round(transaction.time * 1000), 1000)
    clock = time.strftime("%H:%M:%S", time.localtime(seconds))
    where = "-" if transaction.unit is None else f"{transaction.unit}"
    took = "" if transaction.duration is None else f"{transaction.duration * 1000:.1f} ms"
    again = f", repeat {transaction.repeats}" if transaction.repeats else ""
    answer = f"{_answer(transaction)}{again}"
    coloured = _coloured(answer, COLOURS.get(transaction.kind, "31") or (again and REPEATED))
    return f"{clock}.{part:03} {where:>3} {took:>9}  {_question(transaction)} -> {coloured}"


def _question(transaction: Transaction) -> str:
    if transaction.request is not None:
        return str(transaction.request)
    return "?" if transaction.function is None else f"function {transaction.function}?"


def _answer(transaction: Transaction) -> str:
    text, error = transaction.outcome(_shown.repr), transaction.error
    if error is None or isinstance(error, ExceptionResponse):
        return text
    return f"{text}: {_hex(error.received)}"


def _hex(data: bytes) -> str:
    return data[:32].hex(" ") + (" ..." if len(data) > 32 else "")


def _coloured(text: str, colour: str) -> str:
    """Colour, on a terminal whose user wants it (https://no-color.org)."""
    wanted = colour and sys.stdout.isatty() and not os.environ.get("NO_COLOR")
    return f"\x1b[{colour}m{text}\x1b[0m" if wanted else text


# --- JSON ----------------------------------------------------------------------------------


def _print_json(transaction: Transaction) -> None:
    error = transaction.error
    fields = {
        "time": transaction.time,
        "kind": transaction.kind,
        "unit": transaction.unit,
        "function": transaction.function,
        "request": _plain(transaction.request),
        "response": _plain(transaction.response),
        "exception": error.code if isinstance(error, ExceptionResponse) else None,
        "error": None if error is None else str(error.args[0]),
        "received": error.received.hex() if error is not None and error.received else None,
        "duration": transaction.duration,
        "repeats": transaction.repeats,
    }
    print(json.dumps(fields), flush=True)


def _plain(value: Any) -> Any:
    """What JSON has: bytes in hex, requests and named tuples by the names of their fields."""
    if isinstance(value, Request):
        pairs = ((field.name, getattr(value, field.name)) for field in dataclasses.fields(value))  # type: ignore[arg-type]
        return {"name": type(value).__name__, **{name: _plain(each) for name, each in pairs}}
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, enum.Enum):
        return value.value
    named = getattr(value, "_asdict", None)
    if named is not None:
        return _plain(named())
    if isinstance(value, dict):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return value
