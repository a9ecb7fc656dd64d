"""
Lines on a terminal that are drawn again in place.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from typing import TextIO

from .output import styled

__all__ = ["Redrawn"]


class Redrawn:
    """
    Draws lines on a terminal over those that were drawn before, within its current size.

    Args:
        stream: the terminal.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._drawn: list[str] = []

    def draw(self, lines: Sequence[tuple[str, bool]]) -> None:
        """
        Draw the lines that fit on the terminal.

        Args:
            lines: each with True if it is bold.
        """
        columns, rows = shutil.get_terminal_size()
        room = max(1, rows - 1)
        if len(lines) > room:
            more = len(lines) - room + 1
            lines = [*lines[: room - 1], (f"... {more} more", False)]
        drawn = [(_fitting(line, columns), is_bold) for line, is_bold in lines]
        text = "\n".join(
            styled(line, "1" if is_bold else "", self._stream) for line, is_bold in drawn
        )
        self._stream.write(f"{self._back(columns)}{text}\n")
        self._stream.flush()
        self._drawn = [line for line, _ in drawn]

    def clear(self) -> None:
        """Remove the lines, before other output."""
        if self._drawn:
            self._stream.write(self._back(shutil.get_terminal_size().columns))
            self._stream.flush()
            self._drawn = []

    def _back(self, columns: int) -> str:
        """Return the sequence that moves to the first line and clears all lines."""
        height = sum(max(1, -(-len(line) // columns)) for line in self._drawn)
        return f"\x1b[{height}A\r\x1b[J" if height else ""


def _fitting(line: str, columns: int) -> str:
    return "".join(each if each.isprintable() else "?" for each in line)[: max(1, columns - 1)]
