"""
Standard output and standard error, whatever they are.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys

__all__ = ["abandon", "counted", "prepare"]


def prepare() -> None:
    """Let what is printed be taken, also where a stream is closed or knows ASCII only."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by whoever started us
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 (for as long as we live)
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def abandon() -> None:
    """Print nowhere from now on, for what is in the buffer would fail again at the end."""
    with contextlib.suppress(OSError, ValueError):
        printed = sys.stdout.fileno()
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, printed)
        os.close(nowhere)


def counted(number: int, what: str) -> str:
    """Return a number and a noun, in the plural where it must be."""
    return f"{number} {what}{'' if number == 1 else 's'}"
