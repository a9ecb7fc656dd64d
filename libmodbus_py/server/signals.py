"""
Signal handlers in an event loop, and the previous handlers afterwards.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import threading
from collections.abc import Callable, Iterator, Mapping

__all__ = ["Handler", "signal_handlers"]

Handler = Callable[[], object]


@contextlib.contextmanager
def signal_handlers(handlers: Mapping[signal.Signals, Handler]) -> Iterator[None]:
    """
    Call functions on signals while the block runs, then restore the previous handlers.

    Signals reach the main thread only: in any other thread this does nothing.

    Args:
        handlers: signal -> function, called in the running event loop.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    loop = asyncio.get_running_loop()
    before = {number: signal.getsignal(number) for number in handlers}
    for number, handle in handlers.items():
        loop.add_signal_handler(number, handle)
    try:
        yield
    finally:
        for number, handler in before.items():
            loop.remove_signal_handler(number)
            signal.signal(number, handler)
