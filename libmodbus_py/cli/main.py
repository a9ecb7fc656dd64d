"""
The entry point of the command line, and its exit codes.

The exit code is 0, 1 if the device or the line failed, 2 for wrong usage, 130 after Ctrl-C. An
error is one line on stderr. SIGTERM ends the process as such, after what Ctrl-C does.
"""

from __future__ import annotations

import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

__all__ = ["INTERRUPTED", "main"]

INTERRUPTED = 130
"""Exit code after Ctrl-C, as in shells."""


def main(arguments: Sequence[str] | None = None) -> int:
    """
    Run the command line.

    Args:
        arguments: without the name of the program; None for those of the process.

    Returns:
        The exit code.

    Raises:
        SystemExit: after --help and --version, with 0; for wrong usage, with 2.
    """
    # Everything is imported within the try, where Ctrl-C is caught.
    try:
        from . import output
        from .failing import ended_by_sigterm

        output.prepare()
        with ended_by_sigterm():
            try:
                return _run(arguments)
            finally:
                sys.stdout.flush()  # within the try, where a full disk is caught
    except KeyboardInterrupt:
        return INTERRUPTED
    except Exception as error:
        if _is_interrupt(error):
            return INTERRUPTED
        from .failing import failed

        return failed(error)


def _run(arguments: Sequence[str] | None) -> int:
    from .commands import parsed
    from .output import print_log_lines, written_to

    if "_ARGCOMPLETE" in os.environ:
        from .completion import complete

        complete()
    options = parsed(sys.argv[1:] if arguments is None else arguments)
    print_log_lines(is_on=getattr(options, "log_format", None) == "json")
    options.screen = sys.stdout  # while what is printed goes to a file
    options.written_to = getattr(options, "written_to", None)
    try:
        with written_to(options.written_to):
            return int(options.run(options))
    except (ValueError, TypeError) as error:
        parser: argparse.ArgumentParser = options.parser
        parser.error(str(error))


def _is_interrupt(error: BaseException | None) -> bool:
    """Return True if Ctrl-C caused an error, which may have replaced KeyboardInterrupt."""
    seen: set[int] = set()  # errors that are raised again may cause each other
    while error is not None and id(error) not in seen:
        if isinstance(error, KeyboardInterrupt):
            return True
        seen.add(id(error))
        error = error.__cause__ or error.__context__
    return False
