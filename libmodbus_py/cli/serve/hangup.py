"""
SIGHUP: read files again, or end when the terminal was closed.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable

__all__ = ["unless_closed"]


def unless_closed(read_again: Callable[[], object]) -> Callable[[], None]:
    """
    Return a function for SIGHUP.

    An administrator sends SIGHUP after a change of a file, and the system sends it when a terminal
    is closed. In the second case the program ends as on SIGTERM; not under nohup, or without
    a terminal.
    """
    can_close = _has_terminal() and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN

    def hung_up() -> None:
        if can_close and not _has_terminal():
            signal.raise_signal(signal.SIGTERM)
        else:
            read_again()

    return hung_up


def _has_terminal() -> bool:
    try:
        os.close(os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK))
    except OSError:
        return False
    return True
