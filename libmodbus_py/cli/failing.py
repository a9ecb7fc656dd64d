"""
What went wrong: one line, and an exit code.
"""

from __future__ import annotations

import contextlib
import os
import sys

from ..protocol.errors import ModbusError
from . import output
from .commands import PROGRAM

__all__ = ["CommandError", "failed"]


class CommandError(Exception):
    """What a command cannot do, and nobody's usage was wrong."""


def failed(error: Exception) -> int:
    """Say it, and give the exit code."""
    if isinstance(error, OSError) and not isinstance(error, ModbusError):
        output.abandon()
    if not isinstance(error, BrokenPipeError):
        # Else the reader of our output has gone, as `head` does; nothing is left to say.
        with contextlib.suppress(OSError):
            print(f"{PROGRAM}: {_line(error)}", file=sys.stderr, flush=True)
    return 1


def _line(error: Exception) -> str:
    if isinstance(error, ModbusError | CommandError | ImportError):
        text = str(error)
    elif isinstance(error, OSError):
        text = f"{error.filename or 'standard output'}: {error.strerror or error}"
    else:
        from traceback import extract_tb

        place = extract_tb(error.__traceback__)[-1]
        text = f"unexpected {error!r} ({os.path.basename(place.filename)}, line {place.lineno})"
    return text.replace("\n", " ")
