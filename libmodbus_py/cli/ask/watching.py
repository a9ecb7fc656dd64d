"""
read --watch: polls at a steady pace, whatever fails, until Ctrl-C.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from functools import partial
from typing import Any, Protocol

from ...protocol.errors import ModbusError
from ..connecting import connected
from ..failing import CommandError
from .formatters import ReadResult
from .lines import CsvPolls, JsonPolls, TextPolls
from .reading import Reader, object_of
from .table import TerminalTable

__all__ = ["watch"]


class PollPrinter(Protocol):
    """Prints the results of polls."""

    def print(self, results: Sequence[ReadResult]) -> None: ...

    def fail(self, reason: str) -> None: ...


def watch(options: argparse.Namespace) -> int:
    """Poll until Ctrl-C; a lost connection is established again."""
    reader = Reader(options)
    interval: float = options.watch
    with closing(connected(options)) as context:
        shown = _shown(options, reader, f"{context.url}, unit {context.unit}, every {interval:g} s")
        begun = time.monotonic()
        while True:
            _poll(reader, context, shown)
            # From start to start; polls that are late are left out.
            passed = time.monotonic() - begun
            time.sleep(interval - passed % interval)


def _poll(reader: Reader, context: Any, shown: PollPrinter) -> None:
    try:
        results = reader.ask(context)
    except (ModbusError, CommandError) as error:
        shown.fail(str(error))
    else:
        shown.print(results)


def _shown(options: argparse.Namespace, reader: Reader, title: str) -> PollPrinter:
    if options.csv:
        return CsvPolls(reader.formatters)
    if options.json:
        return JsonPolls(partial(object_of, reader), reader.unit)
    has_cursor = sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    # Frames of --verbose would be printed into the table.
    return TerminalTable(title) if has_cursor and not options.verbose else TextPolls()
