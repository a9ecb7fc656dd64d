"""
Errors: one line on stderr, and an exit code.
"""

from __future__ import annotations

import contextlib
import os

from ..protocol.errors import NO_UNIT, ModbusError, ModbusTimeoutError
from . import output

__all__ = ["CommandError", "advice", "failed"]


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


def advice(error: ModbusError) -> str:
    """Return what to try after a failure; empty if nothing is known that would help."""
    is_silent = isinstance(error, ModbusTimeoutError) and not error.received
    if not error.endpoint or not (is_silent or isinstance(error, NO_UNIT)):
        return ""
    place = error.endpoint.removeprefix("tcp://").removesuffix(":502").removeprefix("rtu://")
    return f"; {output.PROGRAM} scan {place.partition('?')[0]} finds the units that answer"


def _line(error: Exception) -> str:
    if isinstance(error, ModbusError):
        text = f"{error}{advice(error)}"
    elif isinstance(error, CommandError | ImportError):
        text = str(error)
    elif isinstance(error, OSError):
        text = f"{error.filename or 'standard output'}: {error.strerror or error}"
    else:
        from traceback import extract_tb

        place = extract_tb(error.__traceback__)[-1]
        text = f"unexpected {error!r} ({os.path.basename(place.filename)}, line {place.lineno})"
    return text.replace("\n", " ")
