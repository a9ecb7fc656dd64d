"""
SIGHUP: files are read again; but whose terminal was closed ends, as other programs do.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable

__all__ = ["unless_closed"]


def unless_closed(read_again: Callable[[], object]) -> Callable[[], None]:
    """
    Give what SIGHUP is to call.

    It comes from people who have changed a file, and from a terminal that closes: then the
    program ends as on SIGTERM. Under nohup, or started without a terminal, it never does.
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
