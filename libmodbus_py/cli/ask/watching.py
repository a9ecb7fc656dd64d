"""
read --watch: polls at a steady pace, whatever fails, until Ctrl-C or the end that was asked for.

On a terminal the values are a table that is drawn again in place; so they are while --csv or --json
write to a file. With --page a page shows them, too.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from typing import Any, TextIO

from ...protocol.errors import ModbusError
from ...protocol.plain import clock_text
from ..connecting import connected
from ..failing import CommandError
from ..output import complain, counted
from ..screen import Redrawn
from ..serve import over_http
from .formatters import ReadResult, aligned
from .reading import Printer, Reader, printer_of, readers_of
from .units import reason_of

__all__ = ["watch"]

CHANGED = "*"


def watch(options: argparse.Namespace) -> int:
    """Poll each unit; a lost connection is established again. Return 1 if no poll succeeded."""
    readers = readers_of(options)
    interval = min(reader.interval for reader in readers)
    with closing(connected(options)) as context:
        units = ",".join(str(reader.unit) for reader in readers)
        title = f"{context.url}, unit {units}, every {interval:g} s"
        with _on_page(options, title, _printer(options, readers, title), interval) as printer:
            polls = _Polls(readers, context, printer)
            try:
                polls.run(interval, options.count, options.lasts or float("inf"))
            finally:
                if options.written_to and sys.stderr.isatty():
                    print(f"{counted(polls.done, 'poll')} in {options.written_to}", file=sys.stderr)
    return 0 if polls.answered else 1


class _Polls:
    """Polls units, one after the other, and counts the polls and those that were answered."""

    def __init__(self, readers: Sequence[Reader], context: Any, printer: Printer) -> None:
        self.done = self.answered = 0
        self._readers = readers
        self._context = context
        self._printer = printer

    def run(self, interval: float, count: int | None, lasts: float) -> None:
        """Poll from start to start at an interval; polls that are late are left out."""
        due = begun = time.monotonic()
        rounds = 0
        while True:
            for reader in self._readers:
                self._poll(reader, due)
            rounds += 1
            now = time.monotonic()
            due = begun + ((now - begun) // interval + 1) * interval
            if rounds == count or due >= begun + lasts:
                return
            time.sleep(max(0.0, due - time.monotonic()))

    def _poll(self, reader: Reader, due: float) -> None:
        try:
            results = reader.ask(self._context, due)
        except (ModbusError, CommandError) as error:
            self._printer.fail(reader.unit, reason_of(error))
        else:
            self._printer.print(reader.unit, results)
            self.answered += 1
        self.done += 1


def _printer(options: argparse.Namespace, readers: Sequence[Reader], title: str) -> Printer:
    """Return what prints the values to the outputs that were typed, and to a terminal."""
    is_file = options.written_to is not None
    screen: TextIO = options.screen
    has_cursor = screen.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    # Frames of --verbose would be printed into the table.
    is_table = has_cursor and not options.verbose and (is_file or not (options.csv or options.json))
    table = TerminalTable(title, [reader.unit for reader in readers], screen) if is_table else None
    if table is not None and not is_file:
        return table
    printer = printer_of(options, readers, are_polls=True)
    return _Both(printer, table or _Failures()) if is_file else printer


class _Both:
    """Passes everything on to two printers."""

    def __init__(self, first: Printer, second: Printer) -> None:
        self._printers = first, second

    def print(self, unit: int, results: Sequence[ReadResult]) -> None:
        for each in self._printers:
            each.print(unit, results)

    def fail(self, unit: int, reason: str) -> None:
        for each in self._printers:
            each.fail(unit, reason)


class _Failures:
    """Prints why a unit has no values, when the reason changes."""

    def __init__(self) -> None:
        self._reasons: dict[int, str] = {}

    def print(self, unit: int, results: Sequence[ReadResult]) -> None:
        self._say(unit, "; ".join(each.failure for each in results if each.failure))

    def fail(self, unit: int, reason: str) -> None:
        self._say(unit, reason)

    def _say(self, unit: int, reason: str) -> None:
        if reason and self._reasons.get(unit) != reason:
            complain(reason)
        self._reasons[unit] = reason


@contextmanager
def _on_page(
    options: argparse.Namespace, title: str, printer: Printer, interval: float
) -> Iterator[Printer]:
    """Show the values on a page too while the block runs, if there is an address."""
    if options.page is None and options.page_token is None:
        yield printer
        return
    from .shown_watch import ShownWatch

    shown = ShownWatch(title, printer, interval)
    with over_http.tables_shown(lambda: shown, options.page, options.page_token, sys.stderr):
        yield shown


# --- on a terminal -------------------------------------------------------------------


class TerminalTable:
    """
    Draws a title, a line for each value with a mark after a change, and failures, within the
    current size of the terminal.
    """

    def __init__(self, title: str, units: Sequence[int], screen: TextIO) -> None:
        self._title = title
        self._groups = {unit: _Group() for unit in units}
        self._polls = self._failed = 0
        self._last_failure = ""
        self._redrawn = Redrawn(screen)

    def print(self, unit: int, results: Sequence[ReadResult]) -> None:
        self._count(unit, any(each.failure for each in results))
        self._groups[unit].take(results)
        self._draw()

    def fail(self, unit: int, reason: str) -> None:
        self._count(unit, True)
        self._groups[unit].lines = [(reason, False)]
        self._draw()

    def _count(self, unit: int, has_failed: bool) -> None:
        self._polls += unit == next(iter(self._groups))
        if has_failed:
            self._failed += 1
            self._last_failure = _clock()

    def _draw(self) -> None:
        failed = f", {self._failed} failed, last at {self._last_failure}" if self._failed else ""
        title = f"{_clock()}  {self._title}, {self._polls} polls{failed}"
        self._redrawn.draw([(title, False), *self._lines()])

    def _lines(self) -> Sequence[tuple[str, bool]]:
        if len(self._groups) == 1:
            (group,) = self._groups.values()
            return group.lines
        found: list[tuple[str, bool]] = []
        for unit, group in self._groups.items():
            found += [(f"unit {unit}", False), *group.lines]
        return found


class _Group:
    """The lines of one unit, each with True if its value has just changed."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, bool]] = []
        self._before: list[str] = []

    def take(self, results: Sequence[ReadResult]) -> None:
        rows = [row for each in results for row in each.rows]
        lines = aligned([(each.formatter, each.rows) for each in results])
        changed = self._changed([row.text for row in rows])
        self.lines = [
            (f"{CHANGED if at in changed else ' '} {line}", at in changed)
            for at, line in enumerate(lines)
        ]
        self.lines += [(each.failure, False) for each in results if each.failure]

    def _changed(self, texts: list[str]) -> set[int]:
        """Return the lines with a new value; none if the number of lines changed."""
        before, self._before = self._before, texts
        if len(before) != len(texts):
            return set()
        return {at for at, (text, old) in enumerate(zip(texts, before, strict=True)) if text != old}


def _clock() -> str:
    return clock_text(time.time())
