"""
SIGHUP: read files and certificates again, or end when the terminal was closed.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator

from ...ports.endpoint import parse
from ...protocol.logs import HarmlessLogger
from ...security.security import reload_all

__all__ = ["is_secure", "noted", "unless_closed"]

logger: HarmlessLogger = HarmlessLogger(__name__)


def is_secure(urls: Iterable[str]) -> bool:
    """Return True if one of these endpoints has certificates."""
    return any(parse(url).is_secure for url in urls)


def unless_closed(*read_again: Callable[[], object]) -> Callable[[], None]:
    """
    Return a function for SIGHUP.

    It reads all files of certificates again, after those of the command.

    An administrator sends SIGHUP after a change of a file, and the system sends it when a terminal
    is closed. In the second case the program ends as on SIGTERM; not under nohup, or without
    a terminal.
    """
    can_close = _has_terminal() and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN

    def hung_up() -> None:
        if can_close and not _has_terminal():
            signal.raise_signal(signal.SIGTERM)
        else:
            for each in read_again:
                each()
            for mistake in reload_all():
                logger.warning("%s", mistake)

    return hung_up


@contextlib.contextmanager
def noted() -> Iterator[Callable[[], bool]]:
    """
    Note SIGHUP in place of ending the program, while a command starts.

    It yields a function that returns True if the signal came.
    """
    before = signal.getsignal(signal.SIGHUP)
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or before in (signal.SIG_IGN, None):
        yield lambda: False
        return
    times = [0]

    def note(number: int, frame: object) -> None:
        times[0] += 1

    signal.signal(signal.SIGHUP, note)
    try:
        yield lambda: times[0] > 0
    finally:
        signal.signal(signal.SIGHUP, before)


def _has_terminal() -> bool:
    try:
        os.close(os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK))
    except OSError:
        return False
    return True
