"""
SIGTERM ends a command as Ctrl-C does: serial ports get their settings back, and files are complete.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress

__all__ = ["ended_by_sigterm"]


@contextmanager
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
        with suppress(ValueError):
            signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    finally:
        if signal.getsignal(signal.SIGTERM) is terminate:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
        if has_come:
            signal.raise_signal(signal.SIGTERM)
