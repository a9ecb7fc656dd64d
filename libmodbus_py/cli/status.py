"""
A status line for long work, on a terminal only.
"""

from __future__ import annotations

import sys
import time

__all__ = ["Status"]

REDRAWN = 0.1
"""Seconds between two states of the line, at least."""


class Status:
    """
    A line on standard error that is drawn again in place.

    Args:
        after: seconds until the line is first drawn.
    """

    def __init__(self, after: float = 0.0) -> None:
        self._is_wanted = sys.stderr.isatty()
        self._is_shown = False
        self._next = time.monotonic() + after

    def show(self, text: str) -> None:
        """Draw a text, unless another one was drawn just now."""
        now = time.monotonic()
        if not self._is_wanted or now < self._next:
            return
        self._next = now + REDRAWN
        self._is_shown = True
        import shutil  # imports three compressors, which a pipe does not need

        fitting = text[: shutil.get_terminal_size().columns - 1]
        print(f"\r{fitting}\x1b[K", end="", file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Remove the line, before other output."""
        if self._is_shown:
            self._is_shown = False
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
