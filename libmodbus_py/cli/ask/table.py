"""
A table on a terminal, drawn again in place.
"""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Sequence

from ..output import styled
from .formatters import ReadResult, aligned

__all__ = ["TerminalTable"]

CHANGED = "*"


class TerminalTable:
    """
    Draws a title, a line for each value with a mark after a change, and failures.

    The table fits the current size of the terminal.

    Args:
        title: the device, unit and interval.
    """

    def __init__(self, title: str) -> None:
        self._title = title
        self._polls = self._failed = 0
        self._before: list[str] = []
        self._drawn: list[str] = []

    def print(self, results: Sequence[ReadResult]) -> None:
        self._polls += 1
        self._failed += any(each.failure for each in results)
        texts = [row.text for each in results for row in each.rows]
        lines = aligned([(each.formatter, each.rows) for each in results])
        changed = self._changed(texts)
        marked = [f"{CHANGED if at in changed else ' '} {line}" for at, line in enumerate(lines)]
        self._draw([*marked, *(each.failure for each in results if each.failure)], changed)

    def fail(self, reason: str) -> None:
        self._polls += 1
        self._failed += 1
        self._draw([reason], set())

    def _changed(self, texts: list[str]) -> set[int]:
        """Return the lines with a new value; none if the number of lines changed."""
        before, self._before = self._before, texts
        if len(before) != len(texts):
            return set()
        return {at for at, (text, old) in enumerate(zip(texts, before, strict=True)) if text != old}

    def _draw(self, lines: list[str], bold: set[int]) -> None:
        columns, rows = shutil.get_terminal_size()
        room = max(1, rows - 2)
        if len(lines) > room:
            more = len(lines) - room + 1
            lines = [*lines[: room - 1], f"... {more} more"]
        clock = time.strftime("%H:%M:%S")
        failed = f", {self._failed} failed" if self._failed else ""
        title = f"{clock}  {self._title}, {self._polls} polls{failed}"
        drawn = [_fitting(line, columns) for line in (title, *lines)]
        text = "\n".join(
            styled(line, "1" if at - 1 in bold else "") for at, line in enumerate(drawn)
        )
        sys.stdout.write(f"{self._back(columns)}{text}\n")
        sys.stdout.flush()
        self._drawn = drawn

    def _back(self, columns: int) -> str:
        """Return the sequence that moves to the first line and clears all lines."""
        height = sum(max(1, -(-len(line) // columns)) for line in self._drawn)
        return f"\x1b[{height}A\r\x1b[J" if height else ""


def _fitting(line: str, columns: int) -> str:
    return "".join(each if each.isprintable() else "?" for each in line)[: max(1, columns - 1)]
