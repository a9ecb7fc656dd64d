"""
Keeps tasks until they end; ends them, also those that lose a cancellation; makes last calls in
cancelled tasks; tells how long to wait before what has failed is tried again; and makes calls that
block in a thread.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import queue
import threading
from collections.abc import Callable, Collection, Coroutine
from typing import Any

# Seconds before the first try after a failure, and before the later ones: a server that is down
# for an hour is asked 120 times.
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 30.0

FINISHING_S = 2.0
"""Seconds that an output has for its last readings, and to close, when the program ends."""

AGAIN = 5.0
"""Seconds after which a task that was cancelled, and has not ended, is cancelled again."""


class KeptTasks(set[asyncio.Task[None]]):
    """Tasks that have not ended. The event loop alone would not keep them from being collected."""

    def begin(self, call: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        """Run a call in a task, which is kept until it ends."""
        task = asyncio.create_task(call)
        self.add(task)
        task.add_done_callback(self.discard)
        return task


async def end_tasks(tasks: Collection[asyncio.Task[Any]]) -> None:
    """
    Cancel tasks, and wait until all have ended. Exceptions that they raise are ignored.

    One cancellation is not enough: `asyncio.wait_for` of Python 3.11, which the clients of MQTT
    and NATS use, loses a cancellation that arrives together with the result that it waits for.
    """
    while waiting := [task for task in tasks if not task.done()]:
        for task in waiting:
            task.cancel()
        await asyncio.wait(waiting, timeout=AGAIN)
    await asyncio.gather(*tasks, return_exceptions=True)  # else asyncio logs what they raised


async def finish(call: Coroutine[Any, Any, Any], seconds: float | None = None) -> None:
    """
    Run the last call of an object that is being closed, for some seconds, by default
    `FINISHING_S`. An exception that it raises is ignored.
    """
    # In a task that was cancelled, `asyncio.timeout` of Python 3.11.2 raises CancelledError at its
    # end, so that objects after it would not be closed.
    task = asyncio.ensure_future(call)
    try:
        await asyncio.wait([task], timeout=FINISHING_S if seconds is None else seconds)
    finally:
        if not task.cancel() and not task.cancelled():
            task.exception()  # else asyncio logs it


class Pauses:
    """The seconds between attempts: each pause is twice as long as the one before."""

    def __init__(self, longest: float = LONGEST_PAUSE_S) -> None:
        self._longest = longest
        self._next = FIRST_PAUSE_S

    def next(self) -> float:
        pause, self._next = self._next, min(2 * self._next, self._longest)
        return pause

    def reset(self) -> None:
        """Begin with the first pause again: a try has succeeded."""
        self._next = FIRST_PAUSE_S


Job = tuple[Callable[..., Any], tuple[Any, ...], asyncio.Future[Any]]


class WriterThread:
    """Calls functions in a thread, in order. A disk that hangs never delays the end."""

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
        future = asyncio.get_running_loop().create_future()
        self._jobs.put((function, arguments, future))
        return await future


def _work(jobs: queue.SimpleQueue[Job | None]) -> None:
    while (job := jobs.get()) is not None:
        function, arguments, future = job
        result, error = None, None
        try:
            result = function(*arguments)
        except BaseException as failure:
            error = failure
        with contextlib.suppress(RuntimeError):  # the loop is closed
            future.get_loop().call_soon_threadsafe(_settle, future, result, error)


def _settle(future: asyncio.Future[Any], result: Any, error: BaseException | None) -> None:
    if not future.done():
        future.set_result(result) if error is None else future.set_exception(error)
