"""
The entry point of the command line, and how a command ends.

The exit code is 0, 1 if the device or the line failed, 2 for wrong usage, 130 after Ctrl-C. An
error is one line on stderr. SIGTERM ends the process as such, after what Ctrl-C does, so that
serial ports get their settings back, and files are complete.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from .parser import Parser

INTERRUPTED = 130
"""Exit code after Ctrl-C, as in shells."""


def main(arguments: Sequence[str] | None = None) -> int:
    """
    Run the command line with arguments, or those of the process, and return the exit code.

    Raises SystemExit after --help and --version, with 0; for wrong usage, with 2.
    """
    # Everything is imported within the try, where Ctrl-C is caught.
    try:
        from .output import prepare

        prepare()
        with _ended_by_sigterm():
            try:
                return _run(sys.argv[1:] if arguments is None else arguments)
            finally:
                sys.stdout.flush()  # within the try, where a full disk is caught
    except KeyboardInterrupt:
        return INTERRUPTED
    except Exception as error:
        # While a class is made, Python 3.11 replaces KeyboardInterrupt.
        if isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
            return INTERRUPTED
        return _failed(error)


def _run(arguments: Sequence[str]) -> int:
    from .commands import parse_arguments
    from .output import print_log_lines, written_to

    if "_ARGCOMPLETE" in os.environ:
        from .completion import complete

        complete()
    options = parse_arguments(arguments)
    print_log_lines(is_on=getattr(options, "log_format", None) == "json")
    options.screen = sys.stdout  # standard output is a file meanwhile
    options.written_to = getattr(options, "written_to", None)
    try:
        goes_on = getattr(options, "adds_rows", False) and bool(options.csv)
        with written_to(options.written_to, goes_on=goes_on):
            return int(options.run(options))
    except (ValueError, TypeError) as error:
        parser: Parser = options.parser
        parser.error(str(error))


# --- how a command ends -------------------------------------------------------------------------


class CommandError(Exception):
    """A command failed, and not because of wrong usage."""


def _failed(error: Exception) -> int:
    from ..protocol.errors import ModbusError
    from .output import abandon, complain

    if isinstance(error, ModbusError | CommandError | ImportError):
        text = f"{error}{advice(error)}"
    elif isinstance(error, OSError):
        abandon()
        text = f"{error.filename or 'standard output'}: {error.strerror or error}"
    else:
        from traceback import extract_tb

        place = extract_tb(error.__traceback__)[-1]
        text = f"unexpected {error!r} ({os.path.basename(place.filename)}, line {place.lineno})"
    if not isinstance(error, BrokenPipeError):
        # After a broken pipe nothing reads the output any more, as with `head`.
        with contextlib.suppress(OSError):
            complain(text.replace("\n", " "))
    return 1


def advice(error: Exception) -> str:
    """Return advice after a failure; empty if none would help."""
    from ..protocol.errors import NO_UNIT, ModbusError, ModbusTimeoutError
    from .output import PROGRAM

    is_silent = isinstance(error, ModbusTimeoutError) and not error.received
    if not (is_silent or isinstance(error, NO_UNIT)) or not isinstance(error, ModbusError):
        return ""
    if not error.endpoint:
        return ""
    place = error.endpoint.removeprefix("tcp://").removesuffix(":502").removeprefix("rtu://")
    return f"; {PROGRAM} scan {place.partition('?')[0]} finds the units that answer"


@contextlib.contextmanager
def _ended_by_sigterm() -> Iterator[None]:
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
