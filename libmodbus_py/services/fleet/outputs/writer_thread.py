"""
A thread for calls that block, such as writing to a slow disk; one call after the other.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import queue
import threading
from collections.abc import Callable
from typing import Any

__all__ = ["WriterThread"]

Job = tuple[Callable[..., Any], tuple[Any, ...], asyncio.Future[Any]]


class WriterThread:
    """Calls functions in a thread, in order. A disk that hangs does not keep the program alive."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._jobs: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None

    @property
    def is_running(self) -> bool:
        """True from `start` to `stop`."""
        return self._thread is not None

    def start(self) -> None:
        """Start the thread, anew after `stop`; raise OSError if the system has too many threads."""
        self._jobs = queue.SimpleQueue()
        name = f"writes {self._name}"
        thread = threading.Thread(target=_work, args=(self._jobs,), name=name, daemon=True)
        try:
            thread.start()
        except RuntimeError as error:
            raise OSError(errno.EAGAIN, str(error), self._name) from error
        self._thread = thread

    def stop(self) -> None:
        """End the thread after the calls that wait; this does not wait for it."""
        self._jobs.put(None)
        self._thread = None

    async def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function in the thread; return its result, or raise its exception."""
        done = asyncio.get_running_loop().create_future()
        self._jobs.put((function, arguments, done))
        return await done


def _work(jobs: queue.SimpleQueue[Job | None]) -> None:
    while (job := jobs.get()) is not None:
        function, arguments, done = job
        try:
            result = function(*arguments)
        except BaseException as error:
            _settle_later(done, None, error)
        else:
            _settle_later(done, result, None)


def _settle_later(done: asyncio.Future[Any], result: Any, error: BaseException | None) -> None:
    with contextlib.suppress(RuntimeError):  # the loop is closed
        done.get_loop().call_soon_threadsafe(_settle, done, result, error)


def _settle(done: asyncio.Future[Any], result: Any, error: BaseException | None) -> None:
    if done.done():
        return
    if error is None:
        done.set_result(result)
    else:
        done.set_exception(error)
