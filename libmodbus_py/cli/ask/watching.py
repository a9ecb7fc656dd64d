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
from contextlib import ExitStack, closing
from typing import TextIO

from ...client.blocking import Context
from ...protocol.errors import ModbusError
from ...protocol.plain import clock_text
from ..connecting import connected
from ..failing import CommandError, advice
from ..output import counted
from ..screen import Redrawn
from ..serve import over_http
from .formatters import ReadResult, aligned
from .reading import Printer, Reader, printer_of, readers_of

__all__ = ["watch"]

CHANGED = "*"


def watch(options: argparse.Namespace) -> int:
    """Poll each unit; a lost connection is established again."""
    readers = readers_of(options)
    interval = min(reader.interval for reader in readers)
    polls = answered = 0
    reason = ""
    with closing(connected(options)) as context, ExitStack() as stack:
        units = ",".join(str(reader.unit) for reader in readers)
        title = f"{context.url}, unit {units}, every {interval:g} s"
        printers = _printers(options, readers, title)
        if options.page is not None or options.page_token is not None:
            from .shown_watch import ShownWatch

            shown = ShownWatch(title, interval)
            printers.append(shown.print)
            page = over_http.tables_shown(
                lambda: shown, options.page, options.page_token, sys.stderr
            )
            stack.enter_context(page)
        try:
            for due in _times(interval, options.count, options.lasts or float("inf")):
                for reader in readers:
                    reason = _poll(reader, context, due, printers)
                    polls += 1
                    answered += not reason
        finally:
            if options.written_to and sys.stderr.isatty():
                print(f"{counted(polls, 'poll')} in {options.written_to}", file=sys.stderr)
    if not answered:
        raise CommandError(f"no poll was answered; the last one: {reason}")
    return 0


def _times(interval: float, count: int | None, lasts: float) -> Iterator[float]:
    """Yield when each poll is due, and wait in between; polls that would be late are left out."""
    due = begun = time.monotonic()
    polls = 0
    while polls != count and due < begun + lasts:
        time.sleep(max(0.0, due - time.monotonic()))
        yield due
        polls += 1
        due = begun + ((time.monotonic() - begun) // interval + 1) * interval


def _poll(reader: Reader, context: Context, due: float, printers: Sequence[Printer]) -> str:
    """Print the results of a unit, or why there are none, which is returned."""
    results, reason = list[ReadResult](), ""
    try:
        results = reader.ask(context, due)
    except (ModbusError, CommandError) as error:
        reason = f"{error}{advice(error)}"
    for each in printers:
        each(reader.unit, results, reason)
    return reason


def _printers(options: argparse.Namespace, readers: Sequence[Reader], title: str) -> list[Printer]:
    """Return what prints the values to the output that was typed, and to a terminal."""
    is_file = options.written_to is not None
    screen: TextIO = options.screen
    has_cursor = screen.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    # Frames of --verbose would be printed into the table.
    is_table = has_cursor and not options.verbose and (is_file or not (options.csv or options.json))
    printers: list[Printer] = []
    if is_file or not is_table:
        printers.append(printer_of(options, readers, are_polls=True))
    if is_table:
        printers.append(_TerminalTable(title, readers, screen).print)
    return printers


class _TerminalTable:
    """Draws a title, a line for each value with a mark after a change, and failures."""

    def __init__(self, title: str, readers: Sequence[Reader], screen: TextIO) -> None:
        self._title = title
        # Unit -> its lines, each with True if its value has just changed.
        self._lines: dict[int, list[tuple[str, bool]]] = {each.unit: [] for each in readers}
        self._texts: dict[int, list[str]] = {}
        self._rounds = self._failed = 0
        self._last_failure = ""
        self._redrawn = Redrawn(screen)

    def print(self, unit: int, results: Sequence[ReadResult], reason: str) -> None:
        failures = [reason] if reason else [each.failure for each in results if each.failure]
        self._rounds += unit == next(iter(self._lines))
        if failures:
            self._failed += 1
            self._last_failure = f", {self._failed} failed, last at {_clock()}"
        lines = [] if reason else self._marked(unit, results)
        self._lines[unit] = [*lines, *((each, False) for each in failures)]
        title = f"{_clock()}  {self._title}, {self._rounds} polls{self._last_failure}"
        shown = [(title, False)]
        for each, its_lines in self._lines.items():
            shown += [(f"unit {each}", False)] if len(self._lines) > 1 else []
            shown += its_lines
        self._redrawn.draw(shown)

    def _marked(self, unit: int, results: Sequence[ReadResult]) -> list[tuple[str, bool]]:
        """Return the lines of a unit; none is marked if the number of lines has changed."""
        texts = [row.text for each in results for row in each.rows]
        before = self._texts.get(unit, [])
        if len(before) != len(texts):
            before = texts
        self._texts[unit] = texts
        return [
            (f"{' ' if text == old else CHANGED} {line}", text != old)
            for line, text, old in zip(aligned(results), texts, before, strict=True)
        ]


def _clock() -> str:
    return clock_text(time.time())
