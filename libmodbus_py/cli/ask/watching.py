"""
Reading again and again: at a steady pace, whatever fails, until Ctrl-C.
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
from .lines import CsvLines, JsonLines, TextLines
from .reading import Reader, object_of
from .table import Table
from .views import Outcome

__all__ = ["watch"]


class Shown(Protocol):
    """What takes polls."""

    def print(self, outcomes: Sequence[Outcome]) -> None: ...

    def fail(self, reason: str) -> None: ...


def watch(options: argparse.Namespace) -> int:
    """Poll for ever; the connection is made again when it is lost."""
    reader = Reader(options)
    interval: float = options.watch
    with closing(connected(options)) as context:
        shown = _shown(options, reader, f"{context.url}, unit {context.unit}, every {interval:g} s")
        begun = time.monotonic()
        while True:
            _poll(reader, context, shown)
            # From start to start; what is late is left out, not made up for.
            passed = time.monotonic() - begun
            time.sleep(interval - passed % interval)


def _poll(reader: Reader, context: Any, shown: Shown) -> None:
    try:
        outcomes = reader.ask(context)
    except (ModbusError, CommandError) as error:
        shown.fail(str(error))
    else:
        shown.print(outcomes)


def _shown(options: argparse.Namespace, reader: Reader, title: str) -> Shown:
    if options.csv:
        return CsvLines(reader.views)
    if options.json:
        return JsonLines(partial(object_of, reader), reader.unit)
    has_cursor = sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    # Frames on the same terminal would be in the middle of it.
    return Table(title) if has_cursor and not options.verbose else TextLines()
