"""
A table on a terminal that is drawn again in its place.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections.abc import Sequence

from .views import Outcome, aligned

__all__ = ["Table"]

CHANGED = "*"


class Table:
    """
    A title, a line for each value with a mark where it has changed, and failures in their place.

    It takes no more than the terminal has, whatever its size has become meanwhile.

    Args:
        title: whom is asked.
    """

    def __init__(self, title: str) -> None:
        self._title = title
        self._polls = self._failed = 0
        self._before: list[str] = []
        self._drawn: list[str] = []
        self._is_coloured = not os.environ.get("NO_COLOR")

    def print(self, outcomes: Sequence[Outcome]) -> None:
        self._polls += 1
        self._failed += any(each.failure for each in outcomes)
        texts = [row.text for each in outcomes for row in each.rows]
        lines = aligned([(each.view, each.rows) for each in outcomes])
        changed = self._changed(texts)
        marked = [f"{CHANGED if at in changed else ' '} {line}" for at, line in enumerate(lines)]
        self._draw([*marked, *(each.failure for each in outcomes if each.failure)], changed)

    def fail(self, reason: str) -> None:
        self._polls += 1
        self._failed += 1
        self._draw([reason], set())

    def _changed(self, texts: list[str]) -> set[int]:
        """Which lines have another value than before; none where there are not as many."""
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
            f"\x1b[1m{line}\x1b[0m" if self._is_coloured and at - 1 in bold else line
            for at, line in enumerate(drawn)
        )
        sys.stdout.write(f"{self._back(columns)}{text}\n")
        sys.stdout.flush()
        self._drawn = drawn

    def _back(self, columns: int) -> str:
        """To where it began, counting what a narrower terminal has wrapped; and clear the rest."""
        height = sum(max(1, -(-len(line) // columns)) for line in self._drawn)
        return f"\x1b[{height}A\r\x1b[J" if height else ""


def _fitting(line: str, columns: int) -> str:
    return "".join(each if each.isprintable() else "?" for each in line)[: max(1, columns - 1)]
