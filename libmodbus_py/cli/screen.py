"""
Work that goes on, on a terminal: a status line, lines that are drawn again in place, progress.
"""

from __future__ import annotations

import os
import sys
import time

from .output import styled

TYPE_CHECKING = False  # see commands
if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import TextIO

    from ..tools.scan.scan import Progress
    from ..tools.scan.search import Extent, Searching

__all__ = ["Redrawn", "Status", "duration", "missing", "progress"]

REDRAWN_S = 0.1
"""Between two states of the status line, at least: faster is unreadable, and costs time."""


class Status:
    """A line on standard error that is drawn again in place, at first `after` seconds."""

    def __init__(self, after: float = 0.0) -> None:
        self._is_wanted = sys.stderr.isatty()
        self._is_shown = False
        self._next = time.monotonic() + after

    def show(self, text: str) -> None:
        """Draw a text, unless another one was drawn just now."""
        now = time.monotonic()
        if not self._is_wanted or now < self._next:
            return
        self._next = now + REDRAWN_S
        self._is_shown = True
        fitting = text[: _size().columns - 1]
        print(f"\r{fitting}\x1b[K", end="", file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Remove the line, before other output."""
        if self._is_shown:
            self._is_shown = False
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)


class Redrawn:
    """Draws lines on a terminal over those that were drawn before, within its current size."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._drawn: list[str] = []

    def draw(self, lines: Sequence[tuple[str, bool]]) -> None:
        """Draw the lines that fit on the terminal, each with True if it is bold."""
        columns, rows = _size()
        room = max(1, rows - 1)
        if len(lines) > room:
            more = len(lines) - room + 1
            lines = [*lines[: room - 1], (f"... {more} more", False)]
        fitting = [
            "".join(each if each.isprintable() else "?" for each in line) for line, _ in lines
        ]
        drawn = [line[: max(1, columns - 1)] for line in fitting]
        text = "\n".join(
            styled(line, "1" if is_bold else "", self._stream)
            for line, (_, is_bold) in zip(drawn, lines, strict=True)
        )
        self._stream.write(f"{self._back(columns)}{text}\n")
        self._stream.flush()
        self._drawn = drawn

    def clear(self) -> None:
        """Remove the lines, before other output."""
        if self._drawn:
            self._stream.write(self._back(_size().columns))
            self._stream.flush()
            self._drawn = []

    def _back(self, columns: int) -> str:
        """Return the sequence that moves to the first line and clears all lines."""
        height = sum(max(1, -(-len(line) // columns)) for line in self._drawn)
        return f"\x1b[{height}A\r\x1b[J" if height else ""


def _size() -> os.terminal_size:
    import shutil  # imports three compressors, which a pipe does not need

    return shutil.get_terminal_size()


def progress(state: Progress | Searching, found: int = 0) -> str:
    """Return the progress of a scan, which has `found` units, or of a search as one line."""
    from ..tools.scan.search import Searching

    if isinstance(state, Searching):
        table = state.table.replace("_", " ")
        return f"unit {state.unit}, {table}: request {state.requests} of {state.most_requests}"
    return (
        f"{state.setting}: unit {state.unit}; {state.done} of {state.total} asked, {found} found, "
        f"{duration(state.left)} left at most"
    )


def missing(extent: Extent) -> str:
    """Return what a search may have missed in a table; empty if nothing."""
    parts = [f"ended by {extent.ended}"] * bool(extent.ended)
    if extent.unseen:
        parts.append(f"ranges of up to {extent.unseen} may have been missed")
    return ", ".join(parts)


def duration(seconds: float) -> str:
    """Return a number of seconds in words, such as "4.2 s" or "3 min 5 s"."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
