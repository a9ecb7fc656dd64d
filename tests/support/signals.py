"""What happens to this process in the midst of a test: signals, and forks."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


def interrupt() -> None:
    """Raise KeyboardInterrupt, as Ctrl-C does."""
    raise KeyboardInterrupt


@contextmanager
def on_alarm(act: Callable[[], object], seconds: float) -> Iterator[None]:
    """Call a function in a signal handler in so many seconds."""
    before = signal.signal(signal.SIGALRM, lambda *_: act())
    limit = signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        signal.setitimer(signal.ITIMER_REAL, *limit)  # of the test, which waited meanwhile


def in_child(act: Callable[[], object], meanwhile: Callable[[], object] = lambda: None) -> int:
    """Fork, do it in the child, and give its exit status: 0, 1 for an error, -14 for a hang."""
    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(30)
        try:
            act()
        except BaseException as error:
            print(repr(error), file=sys.stderr)
            os._exit(1)
        os._exit(0)
    meanwhile()
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
