"""
Errors: one line on stderr, and an exit code.
"""

from __future__ import annotations

import contextlib
import os

from ..protocol.errors import ModbusError
from . import output

__all__ = ["CommandError", "failed"]


class CommandError(Exception):
    """A command failed, and not because of wrong usage."""


def failed(error: Exception) -> int:
    """Print an error, and return the exit code."""
    if isinstance(error, OSError) and not isinstance(error, ModbusError):
        output.abandon()
    if not isinstance(error, BrokenPipeError):
        # After a broken pipe nothing reads the output any more, as with `head`.
        with contextlib.suppress(OSError):
            output.complain(_line(error))
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
