"""
One line on a terminal that says how far long work is; nothing elsewhere.
"""

from __future__ import annotations

import sys
import time

__all__ = ["Status"]

REDRAWN = 0.1
"""Seconds between two states of the progress, at least."""


class Status:
    """
    The line, on standard error.

    Args:
        after: seconds before it is first shown.
    """

    def __init__(self, after: float = 0.0) -> None:
        self._is_wanted = sys.stderr.isatty()
        self._is_shown = False
        self._next = time.monotonic() + after

    def show(self, text: str) -> None:
        """Show it, unless there was another one just now."""
        now = time.monotonic()
        if not self._is_wanted or now < self._next:
            return
        self._next = now + REDRAWN
        self._is_shown = True
        import shutil  # brings three compressors, and nobody sees this in a pipe

        fitting = text[: shutil.get_terminal_size().columns - 1]
        print(f"\r{fitting}\x1b[K", end="", file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Take it away, before something else is printed."""
        if self._is_shown:
            self._is_shown = False
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
