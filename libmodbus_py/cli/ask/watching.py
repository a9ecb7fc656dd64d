"""
read --watch: polls at a steady pace, whatever fails, until Ctrl-C or the end that was asked for.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

from ...protocol.errors import ModbusError
from ..connecting import connected
from ..failing import CommandError
from ..serve import page
from .lines import CsvPolls, JsonPolls, TextPolls
from .reading import Printer, Reader, object_of, readers_of
from .table import TerminalTable
from .units import reason_of

__all__ = ["watch"]


def watch(options: argparse.Namespace) -> int:
    """Poll each unit; a lost connection is established again. Return 1 if no poll succeeded."""
    readers = readers_of(options)
    interval = min(reader.interval for reader in readers)
    left = options.count
    with closing(connected(options)) as context:
        units = ",".join(str(reader.unit) for reader in readers)
        title = f"{context.url}, unit {units}, every {interval:g} s"
        with _on_page(options, title, _shown(options, readers, title), interval) as shown:
            begun = time.monotonic()
            until = begun + (options.lasts or float("inf"))
            due, code = begun, 1
            while True:
                for reader in readers:
                    if _poll(reader, context, shown, due):
                        code = 0
                left = left and left - 1
                # From start to start; polls that are late are left out.
                passed = time.monotonic() - begun
                due = begun + (passed // interval + 1) * interval
                if left == 0 or due >= until:
                    return code
                time.sleep(max(0.0, due - time.monotonic()))


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
    with page.tables_shown(lambda: shown, options.page, options.page_token, sys.stderr):
        yield shown


def _poll(reader: Reader, context: Any, shown: Printer, due: float) -> bool:
    """Return True if the unit answered."""
    try:
        results = reader.ask(context, due)
    except (ModbusError, CommandError) as error:
        shown.fail(reader.unit, reason_of(error))
        return False
    shown.print(reader.unit, results)
    return True


def _shown(options: argparse.Namespace, readers: list[Reader], title: str) -> Printer:
    several = len(readers) > 1
    if options.csv:
        return CsvPolls(readers[0].formatters, has_unit=several)
    if options.json:
        return JsonPolls(object_of)
    has_cursor = sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    # Frames of --verbose would be printed into the table.
    if has_cursor and not options.verbose:
        return TerminalTable(title, [reader.unit for reader in readers])
    return TextPolls(has_unit=several)
