"""
Programs that do nothing but serve: signals that end them, and no search for garbage meanwhile.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import signal
import threading
from collections.abc import Callable, Iterator, Mapping

__all__ = ["Handler", "frozen_garbage", "signal_handlers"]

Handler = Callable[[], object]

# Python 3.12 has frozen some objects of its own; PyPy freezes none.
OF_PYTHON: int | None = gc.get_freeze_count() if hasattr(gc, "freeze") else None


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


@contextlib.contextmanager
def frozen_garbage() -> Iterator[None]:
    """
    Search nothing that exists now for garbage while the block runs: a full search takes 5 ms for
    what a server has imported, and a tenth of a second for many devices.

    A program that has called `gc.freeze` itself keeps what it has frozen, and nothing is added.
    """
    if OF_PYTHON is None or gc.get_freeze_count() > OF_PYTHON:
        yield
        return
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
