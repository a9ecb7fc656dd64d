"""
The command read with --watch: all items of each unit are read at a steady pace, whatever fails,
until Ctrl-C or the end that was asked for.

On a terminal the values are a table that is drawn again in place; so they are while --csv or --json
write to a file. With --page a page shows them, too.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from functools import partial
from typing import Any, TextIO

from ...client.blocking import Client
from ...maps.watched import PointIntervals, Totals
from ...protocol.errors import ModbusError
from ..arguments import new_client
from ..main import CommandError, advice
from ..output import complain, counted
from ..serve import over_http
from .formatters import Printer, ReadResult, TerminalTable, printer_of
from .reading import Reader
from .units import units_of


class Watcher(Reader):
    """
    Reads the items that were typed from one unit again and again.

    Attributes:
        interval: seconds from one poll to the next: that of --watch, or the shortest of a point.
    """

    def __init__(self, options: argparse.Namespace, unit: int) -> None:
        super().__init__(options, unit)
        points = [item.point for item in self.items]
        intervals = [None if point is None else point.interval for point in points]
        self._pace = PointIntervals(intervals, options.watch)
        self.interval: float = self._pace.interval
        self._totals = Totals(at for at, point in enumerate(points) if point and point.never_falls)
        self._results: dict[int, ReadResult] = {}

    def poll(self, client: Client, at: float) -> list[ReadResult]:
        """
        Read all items that are due; the others keep their last results.

        A total that is smaller than before is read again. `at` is when this poll is due, in seconds
        of any steady clock. Raises what `ask` does.
        """
        results = self.ask(client, self._pace.due(at))
        doubtful, _ = self._totals.take(self._values(results))
        if doubtful:
            again = self.ask(client, tuple(sorted(doubtful)))
            _, fell = self._totals.take(self._values(again))
            for index in fell:
                remark = f"{again[index].fields['name']} is smaller than before"
                again[index] = again[index]._replace(remark=remark, has_fallen=True)
            results |= again
        self._pace.done()
        self._results |= results
        return [self._results[index] for index in range(len(self.items))]

    def _values(self, results: dict[int, ReadResult]) -> list[Any]:
        indexes = range(len(self.items))
        return [results[at].fields.get("value") if at in results else None for at in indexes]


def watch(options: argparse.Namespace) -> int:
    """Poll each unit; a lost connection is established again."""
    readers = [Watcher(options, unit) for unit in units_of(options)]
    interval = min(reader.interval for reader in readers)
    is_answered, polls = False, 0
    with closing(new_client(options)) as context, ExitStack() as stack:
        units = ",".join(str(reader.unit) for reader in readers)
        title = f"{context.url}, unit {units}, every {interval:g} s"
        printers = _printers(options, readers, title)

        def make() -> Any:
            from .shown_watch import ShownWatch

            page = ShownWatch(title, interval)
            printers.append(page.print)
            return page

        stack.enter_context(over_http.tables_shown(make, options))
        try:
            for due in _times(interval, options.count, options.lasts or float("inf")):
                for reader in readers:
                    is_answered |= _poll(reader, context, due, printers)
                    polls += 1
        finally:
            if options.written_to and sys.stderr.isatty():
                print(f"{counted(polls, 'poll')} in {options.written_to}", file=sys.stderr)
    if not is_answered:
        raise CommandError("no poll was answered")
    return 0


def _times(interval: float, count: int | None, lasts: float) -> Iterator[float]:
    """Yield when each poll is due, and wait in between; polls that would be late are left out."""
    due = start = time.monotonic()
    polls = 0
    while polls != count and due < start + lasts:
        time.sleep(max(0.0, due - time.monotonic()))
        yield due
        polls += 1
        due = start + ((time.monotonic() - start) // interval + 1) * interval


def _poll(reader: Watcher, context: Client, due: float, printers: Sequence[Printer]) -> bool:
    """Print the results of a unit, or the reason without results; return True with results."""
    results, reason = list[ReadResult](), ""
    try:
        results = reader.poll(context, due)
    except (ModbusError, CommandError) as error:
        reason = f"{error}{advice(error)}"
    for printer in printers:
        printer(reader.unit, results, reason)
    return not reason


def _printers(options: argparse.Namespace, readers: Sequence[Watcher], title: str) -> list[Printer]:
    """Return what prints the values to the output that was typed, and to a terminal."""
    is_file = options.written_to is not None
    screen: TextIO = options.screen
    has_cursor = screen.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    # Frames of --verbose would be printed into the table.
    is_table = has_cursor and not options.verbose and (is_file or not (options.csv or options.json))
    printers: list[Printer] = []
    if is_file or not is_table:
        several = len(readers) > 1
        printers.append(printer_of(options, readers[0].items, several=several, are_polls=True))
    if is_table:
        printers.append(TerminalTable(title, [reader.unit for reader in readers], screen).print)
    elif is_file:
        printers.append(partial(_complain, dict[int, str]()))
    return printers


def _complain(notes: dict[int, str], unit: int, results: Sequence[ReadResult], reason: str) -> None:
    """Print why values of a unit are missing, if this differs from the last message about it."""
    text = reason or "; ".join(result.failure for result in results if result.failure)
    if text and text != notes.get(unit):
        complain(text)
    notes[unit] = text
