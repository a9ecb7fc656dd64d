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
    Run the command line with arguments, or those of the process, and return the exit code.

    Raises SystemExit after --help and --version, with 0; for wrong usage, with 2.
    """
    # Everything is imported within the try, where Ctrl-C is caught.
    try:
        from . import output
        from .failing import ended_by_sigterm

        output.prepare()
        with ended_by_sigterm():
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
        from .failing import failed

        return failed(error)


def _run(arguments: Sequence[str]) -> int:
    from .commands import parsed
    from .output import print_log_lines, written_to

    if "_ARGCOMPLETE" in os.environ:
        from .completion import complete

        complete()
    options = parsed(arguments)
    print_log_lines(is_on=getattr(options, "log_format", None) == "json")
    options.screen = sys.stdout  # while what is printed goes to a file
    options.written_to = getattr(options, "written_to", None)
    try:
        with written_to(options.written_to):
            return int(options.run(options))
    except (ValueError, TypeError) as error:
        parser: argparse.ArgumentParser = options.parser
        parser.error(str(error))
