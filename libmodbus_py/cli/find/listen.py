"""
The command listen: the traffic on a line, one line of output for each transaction; or the values
that it carries, by the names of a register map.
"""

from __future__ import annotations

import argparse
import logging
import reprlib
import signal
import sys
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from ...ports.options import SERIAL_OPTIONS
from ...protocol.errors import ExceptionResponse, in_hex
from ...protocol.plain import clock_text, plain, time_text
from ...tools.listener.listener import CAPTURES, listen
from ...tools.listener.transaction import Transaction
from .. import arguments
from ..arguments import with_options
from ..output import PROGRAM, complain, counted, harmless, print_csv, print_json, styled
from ..parser import Parser, declare

if TYPE_CHECKING:
    from ...tools.listener.named import LearnedMap, MapDecoder, NamedValue
    from ..ask.formatters import ValueText

RED, YELLOW = "31", "33"

STYLES = {"answered": "", "broadcast": "", "late": YELLOW, "exception": YELLOW}
"""Kind of a transaction -> style of the answer; that of other kinds is red."""

_shown = reprlib.Repr()
_shown.maxlist = _shown.maxtuple = _shown.maxdict = 16
_shown.maxstring = _shown.maxother = 200

DESCRIPTION = """\
Print every transaction on a line, and a summary after Ctrl-C. Nothing is
sent. Traffic in TLS cannot be read; libmodbus-py gateway -v shows the requests
that it forwards from tls:// to tls://.

With --map, print the values that masters read and write instead, by name. A
point is printed when its last register is read or written; its others, and the
point that scales it, are those heard last."""

EPILOG = """\
The exit code is 0, or 1 if the capture could not be written to the end, or an
answer differs.

examples:
  libmodbus-py listen /dev/ttyUSB0 -b 9600 -p none -u 1-9 --capture line.pcapng
  libmodbus-py listen rtu+tcp://127.0.0.1:1502 --between rtu+tcp://192.0.2.9:502
  libmodbus-py listen /dev/ttyUSB0 -u 7 --map meter.csv --csv values.csv
  libmodbus-py listen plant.pcap --compare-with tcp://192.0.2.9

URL: rtu:///dev/ttyUSB0 or ascii:///dev/ttyUSB0, or just /dev/ttyUSB0;
     rtu+tcp://HOST:PORT or ascii+tcp://HOST:PORT with --between; or the path
     of a capture, FILE.pcapng or FILE.pcap. Settings follow a question mark,
     as in "rtu:///dev/ttyUSB0?baudrate=9600&parity=N". Quote such a URL,
     because shells interpret &. An option overrides the setting in the URL."""

ARGUMENTS = """
URL
    where to listen, or a capture to read: FILE.pcapng, or FILE.pcap of tcpdump
--between URL
    connect to this device, and forward requests and answers between it and clients
--capture FILE.pcapng
    write what is heard to a file for Wireshark
--map FILE
    print values by the names of a register map, CSV or TOML, or an example such as meter
--compare-with URL
    send the requests of a capture to this device, and print those whose answers differ now; URL may
    have options, as in tcp://192.0.2.9?timeout=0.5
--writes
    with --compare-with, send requests that write, too
--learn FILE
    write a new map of the registers that are read and written, CSV or TOML, in the end
"""


def add_command(command: Parser) -> None:
    command.description, command.epilog = DESCRIPTION, EPILOG
    declare(command, ARGUMENTS, map={"complete": arguments.maps})
    arguments.add_columns(command, encoding=True)
    arguments.add_forms(command.exclusive(), "with --map, print CSV")
    arguments.add_units(command, "print the transactions of these units only, such as 1-9,17")
    arguments.add_serial_options(command)
    command.set_defaults(run=_listen)


def _listen(options: argparse.Namespace) -> int:
    logging.basicConfig(format="%(message)s", level=logging.WARNING)  # to stderr
    place = options.url
    is_live = "://" in place or not place.endswith(CAPTURES)
    if is_live:  # the path of a device is a URL, too
        place = with_options([place], options, SERIAL_OPTIONS)[0].url
    else:
        why = f"applies to serial ports only, not to {place}"
        arguments.refuse_options(options, SERIAL_OPTIONS, why)
    if options.compare_with is not None:
        return _compare(options, place, is_live=is_live)
    if options.writes:
        raise ValueError("--writes needs --compare-with")
    show, learned_map = _shower(options), _learned(options)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with listen(place, between=options.between, capture=options.capture) as line:

        def stop(number: int, _: object) -> None:
            signal.signal(number, before[signal.Signals(number)])  # the second one ends the process
            line.close()

        def take(transactions: Iterable[Transaction]) -> None:
            for transaction in transactions:
                if options.units is None or transaction.unit in options.units:
                    if learned_map is not None:
                        learned_map.add_transaction(transaction)
                    show(transaction)

        try:
            for number, handler in before.items():
                if handler is not signal.SIG_IGN:
                    signal.signal(number, stop)
            if is_live:
                print(f"listening on {line.url}", file=sys.stderr, flush=True)
            take(line)
            if is_live and sys.stdout.isatty():
                print()  # after the ^C
            take(line.rest())
            if options.json:
                print_json({"summary": line.summary.as_dict()})
            elif not options.csv:
                print(line.summary, flush=True)
            return 0 if line.capture_error is None else 1
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
            if learned_map is not None:
                _write(learned_map, options.learn, line.url)


def _compare(options: argparse.Namespace, path: str, *, is_live: bool) -> int:
    """Repeat the requests of a capture at a device, and print the answers that differ."""
    from ...client.blocking import Client
    from ...tools.listener.replay import differences

    others = [name for name in ("between", "capture", "map", "learn", "csv") if vars(options)[name]]
    if is_live or others:
        reason = f"--{others[0]} cannot be given with" if others else "URL must be a capture with"
        raise ValueError(f"{reason} --compare-with")
    count = differing = 0
    with Client(options.compare_with) as client:
        for pair in differences(client, path, units=options.units, writes=options.writes):
            count += 1
            if pair is None:
                continue
            differing += 1
            if options.json:
                now, error = pair.answer, None
                if isinstance(now, Exception):
                    now, error = None, str(now)
                print_json({**_plain(pair.transaction), "now": plain(now), "now_error": error})
            else:
                now = _shown.repr(pair.answer)
                if isinstance(pair.answer, Exception):
                    now = str(pair.answer)
                print(f"{line_of(pair.transaction)}; now {styled(now, RED)}", flush=True)
    if not count:
        raise ValueError(f"{path}: no request to send; --writes sends those that write")
    complain(f"{counted(count, 'request')}, {differing} with another answer now")
    return min(differing, 1)


def _shower(options: argparse.Namespace) -> Callable[[Transaction], None]:
    """Return what prints a transaction, or the values that it has of the points of a map."""
    from ..ask.items import map_of

    points = map_of(options)
    if points is None:
        if options.csv:
            raise ValueError("--csv needs --map, which has the names of the values")
        return lambda pair: print_json(_plain(pair)) if options.json else _print_line(pair)
    from ...tools.listener.named import MapDecoder

    decoder = MapDecoder(points)
    if options.csv:
        print_csv([["time", "unit", "name", "value", "units", "written", "error"]])
    print_values = _print_csv if options.csv else _print_objects if options.json else _print_values
    return lambda pair: print_values(decoder, decoder.decode(pair))


def _learned(options: argparse.Namespace) -> LearnedMap | None:
    """Return the map of the observed requests, to be written to a file; None for none."""
    if options.learn is None:
        return None
    from ...tools.listener.named import LearnedMap
    from ..ask.map_actions import TEXTS, check_output

    check_output(options.learn, TEXTS)
    return LearnedMap()


def _write(learned_map: LearnedMap, path: str, url: str) -> None:
    from ..ask.map_actions import write_map

    points = learned_map.points()
    if not points:
        complain(f"{path} is not written: no register was read or written")
        return
    heading = [f"# What masters read and write on {url}, heard by {PROGRAM} listen"]
    write_map(path, heading, points, "; fill in names, types and units")


def _print_line(transaction: Transaction) -> None:
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


# --- values by name ------------------------------------------------------------------------------


def _print_values(decoder: MapDecoder, values: Iterable[NamedValue]) -> None:
    for value in values:
        clock = clock_text(value.time, with_milliseconds=True)
        for row in _rows(decoder, value):
            text = f"{clock} {value.unit:>3}  {row.where}  {row.text} {row.unit}".rstrip()
            print(harmless(f"{text}{'  (written)' * value.is_written}"), flush=True)


def _print_csv(decoder: MapDecoder, values: Iterable[NamedValue]) -> None:
    for value in values:
        whence = [time_text(value.time), value.unit]
        rest = [value.units, int(value.is_written), value.reason]
        print_csv([*whence, row.where, row.plain, *rest] for row in _rows(decoder, value))


def _print_objects(_: MapDecoder, values: Iterable[NamedValue]) -> None:
    for value in values:
        fields = {
            "time": time_text(value.time),
            "unit": value.unit,
            "name": value.name,
            "value": plain(value.value),
            "units": value.units,
            "written": value.is_written,
        }
        missing = {"no_value": {"quality": value.quality, "reason": value.reason}}
        print_json({**fields, **missing} if value.reason else fields)


def _rows(decoder: MapDecoder, value: NamedValue) -> list[ValueText]:
    from ..ask.formatters import rows_of_point

    return rows_of_point(decoder.map[value.name], value.value, value.reason)
