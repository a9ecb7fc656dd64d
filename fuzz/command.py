"""
What the long programs here have in common: numbers as arguments, and a line on the terminal.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import threading
import time
from collections.abc import Iterator

__all__ = ["numbers", "progress"]


def numbers(description: str | None, **defaults: int) -> list[int]:
    """Read as many numbers from the command line; a wrong one ends the program in one line."""
    parser = argparse.ArgumentParser(
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage=argparse.SUPPRESS,  # an error is one line
    )
    for name, default in defaults.items():
        parser.add_argument(name, type=int, nargs="?", default=default, help=f"({default})")
    options = parser.parse_args()
    return [getattr(options, name) for name in defaults]


@contextlib.contextmanager
def progress(what: str) -> Iterator[None]:
    """Show the elapsed time on a terminal; nothing in a pipe."""
    if not sys.stderr.isatty():
        yield
        return
    done = threading.Event()
    start = time.monotonic()

    def show() -> None:
        while not done.wait(1):
            passed = time.monotonic() - start
            print(f"\r{what}: {passed:.0f} s", end="", file=sys.stderr, flush=True)

    thread = threading.Thread(target=show)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
        print("\r\033[K", end="", file=sys.stderr)
