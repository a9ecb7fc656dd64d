"""
The end of a command: an error is one line on stderr and an exit code. SIGTERM ends it as Ctrl-C
does, so that serial ports get their settings back, and files are complete.
"""

from __future__ import annotations

import contextlib
import os
import signal

from . import output

TYPE_CHECKING = False  # see commands
if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["CommandError", "advice", "ended_by_sigterm", "failed"]


class CommandError(Exception):
    """A command failed, and not because of wrong usage."""


def failed(error: Exception) -> int:
    """Print an error, and return the exit code."""
    from ..protocol.errors import ModbusError

    if isinstance(error, ModbusError | CommandError | ImportError):
        text = f"{error}{advice(error)}"
    elif isinstance(error, OSError):
        output.abandon()
        text = f"{error.filename or 'standard output'}: {error.strerror or error}"
    else:
        from traceback import extract_tb

        place = extract_tb(error.__traceback__)[-1]
        text = f"unexpected {error!r} ({os.path.basename(place.filename)}, line {place.lineno})"
    if not isinstance(error, BrokenPipeError):
        # After a broken pipe nothing reads the output any more, as with `head`.
        with contextlib.suppress(OSError):
            output.complain(text.replace("\n", " "))
    return 1


def advice(error: Exception) -> str:
    """Return what to try after a failure; empty if nothing is known that would help."""
    from ..protocol.errors import NO_UNIT, ModbusError, ModbusTimeoutError

    is_silent = isinstance(error, ModbusTimeoutError) and not error.received
    if not (is_silent or isinstance(error, NO_UNIT)) or not isinstance(error, ModbusError):
        return ""
    if not error.endpoint:
        return ""
    place = error.endpoint.removeprefix("tcp://").removesuffix(":502").removeprefix("rtu://")
    return f"; {output.PROGRAM} scan {place.partition('?')[0]} finds the units that answer"


@contextlib.contextmanager
def ended_by_sigterm() -> Iterator[None]:
    """
    Raise KeyboardInterrupt in the block when SIGTERM comes, and end the process by it afterwards.

    A second SIGTERM ends the process at once. Commands that serve replace this with their own
    handlers. A process that ignores SIGTERM continues to, and a thread other than the main one
    changes nothing.
    """
    has_come = False

    def terminate(number: int, frame: object) -> None:
        nonlocal has_come
        has_come = True
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        raise KeyboardInterrupt

    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        with contextlib.suppress(ValueError):
            signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    finally:
        if signal.getsignal(signal.SIGTERM) is terminate:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
        if has_come:
            signal.raise_signal(signal.SIGTERM)
