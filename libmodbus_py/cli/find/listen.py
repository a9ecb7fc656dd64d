"""
The command listen: the traffic on a line, one line of output for each transaction.
"""

from __future__ import annotations

import argparse
import logging
import reprlib
import signal
import sys
from collections.abc import Iterable
from typing import Any

from ...ports.options import SERIAL_OPTIONS
from ...protocol.errors import ExceptionResponse, in_hex
from ...protocol.plain import clock_text, plain, time_text
from ...tools.listener.listener import listen
from ...tools.listener.transaction import Transaction
from .. import arguments
from ..arguments import declare, with_options
from ..output import print_json, styled

__all__ = ["add_command"]

RED, YELLOW = "31", "33"

STYLES = {"answered": "", "broadcast": "", "late": YELLOW, "exception": YELLOW}
"""Kind of a transaction -> style of the answer; that of other kinds is red."""

_shown = reprlib.Repr()
_shown.maxlist = _shown.maxtuple = _shown.maxdict = 16
_shown.maxstring = _shown.maxother = 200


DESCRIPTION = """\
Print every transaction on a line, and a summary after Ctrl-C. Nothing is
sent. Traffic in TLS cannot be read; libmodbus-py gateway -v shows the requests
that it forwards from tls:// to tls://."""

EPILOG = """\
The exit code is 0, or 1 if the capture could not be written to the end.

examples:
  libmodbus-py listen /dev/ttyUSB0
  libmodbus-py listen /dev/ttyUSB0 -b 9600 -p none -u 1-9 --capture line.pcapng
  libmodbus-py listen rtu+tcp://127.0.0.1:1502 --between rtu+tcp://192.0.2.9:502
  libmodbus-py listen line.pcapng

URL: rtu:///dev/ttyUSB0 or ascii:///dev/ttyUSB0, or just /dev/ttyUSB0;
     rtu+tcp://HOST:PORT or ascii+tcp://HOST:PORT with --between; or the path
     of a capture, FILE.pcapng. Settings follow a question mark, as in
     "rtu:///dev/ttyUSB0?baudrate=9600&parity=N". Quote such a URL, because
     shells interpret &. An option overrides the setting in the URL."""


ARGUMENTS = """
URL
    where to listen, or a capture to read: FILE.pcapng
--between URL
    connect to this device, and forward requests and answers between it and clients
--capture FILE.pcapng
    write what is heard to a file for Wireshark
"""


def add_command(command: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    command.description, command.epilog = DESCRIPTION, EPILOG
    declare(command, ARGUMENTS)
    arguments.add_forms(command)
    arguments.add_units(command, "print the transactions of these units only, such as 1-9,17")
    arguments.add_serial_options(command)
    command.set_defaults(run=_listen)


def _listen(options: argparse.Namespace) -> int:
    logging.basicConfig(format="%(message)s", level=logging.WARNING)  # to stderr
    place = options.url
    is_live = "://" in place or not place.endswith(".pcapng")
    if is_live:  # the path of a device is a URL, too
        place = with_options([place], options, SERIAL_OPTIONS)[0].url
    else:
        why = f"applies to serial ports only, not to {place}"
        arguments.refuse_given(options, SERIAL_OPTIONS, why)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with listen(place, between=options.between, capture=options.capture) as line:

        def stop(number: int, _: object) -> None:
            signal.signal(number, before[signal.Signals(number)])  # the second one ends all
            line.close()

        try:
            for number, handler in before.items():
                if handler is not signal.SIG_IGN:
                    signal.signal(number, stop)
            if is_live:
                print(f"listening on {line.url}", file=sys.stderr, flush=True)
            _print_all(line, options)
            if is_live and sys.stdout.isatty():
                print()  # after the ^C
            _print_all(line.rest(), options)
            if options.json:
                print_json({"summary": line.summary.as_dict()})
            else:
                print(line.summary, flush=True)
            return 0 if line.capture_error is None else 1
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def _print_all(transactions: Iterable[Transaction], options: argparse.Namespace) -> None:
    for transaction in transactions:
        if options.units is not None and transaction.unit not in options.units:
            continue
        if options.json:
            print_json(_plain(transaction))
        else:
            print(line_of(transaction), flush=True)


def line_of(transaction: Transaction) -> str:
    """Return a transaction as one line: time, unit, duration, request and answer."""
    clock = clock_text(transaction.time, with_milliseconds=True)
    where = "-" if transaction.unit is None else f"{transaction.unit}"
    took = "" if transaction.duration is None else f"{transaction.duration * 1000:.1f} ms"
    question = "?" if transaction.function is None else f"function {transaction.function}?"
    if transaction.request is not None:
        question = str(transaction.request)
    answer, error = transaction.outcome(_shown.repr), transaction.error
    if error is not None and not isinstance(error, ExceptionResponse):
        answer = f"{answer}: {in_hex(error.received)}"
    if transaction.repeats:
        answer = f"{answer}, repeat {transaction.repeats}"
    style = STYLES.get(transaction.kind, RED) or YELLOW * bool(transaction.repeats)
    return f"{clock} {where:>3} {took:>9}  {question} -> {styled(answer, style)}"


def _plain(transaction: Transaction) -> dict[str, Any]:
    """Return a transaction as an object of JSON."""
    error = transaction.error
    return {
        "time": time_text(transaction.time),
        "kind": transaction.kind,
        "unit": transaction.unit,
        "function": transaction.function,
        "request": plain(transaction.request),
        "response": plain(transaction.response),
        "exception": error.code if isinstance(error, ExceptionResponse) else None,
        "error": None if error is None else str(error.args[0]),
        "received": error.received.hex() if error is not None and error.received else None,
        "duration": transaction.duration,
        "repeats": transaction.repeats,
    }
