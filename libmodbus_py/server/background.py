"""
A server in a thread of its own, which ends even if the starting thread is interrupted.
"""

from __future__ import annotations

import _thread
import asyncio
import contextlib
import threading
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from functools import partial
from typing import Generic, TypeVar

from ..protocol.errors import ModbusConnectionError, ModbusError
from ..protocol.logs import HarmlessLogger

__all__ = ["Background"]

logger: HarmlessLogger = HarmlessLogger(__name__)

Running = TypeVar("Running")


class Background(Generic[Running]):
    """
    A server in a separate thread that serves while the ``with`` block runs.

    When the block has been left, even by Ctrl-C, the thread has ended and all endpoints are closed.
    If Ctrl-C comes right before the end of the block, or the block is never left and the object is
    forgotten, they end soon after, without a wait.

    Args:
        serving: returns a context manager that serves while it is entered.
    """

    def __init__(self, serving: Callable[[], AbstractAsyncContextManager[Running]]) -> None:
        self._thread = InThread(serving)
        self._entered = threading.Lock()

    def __enter__(self) -> Running:
        """
        Raises:
            RuntimeError: it was entered before.
        """
        if not self._entered.acquire(blocking=False):
            raise RuntimeError("this server runs, or did so before: call background() again")
        try:
            return self._thread.start()
        except BaseException:
            self._finish()
            raise

    def __exit__(self, *_: object) -> None:
        self._finish()

    def __del__(self) -> None:
        # Ctrl-C may have come before __exit__ began. This waits for nothing: the server's thread
        # may wait for a lock that is held where the garbage collector runs.
        thread = vars(self).get("_thread")
        if thread is not None:
            thread.stop()

    def _finish(self) -> None:
        try:
            self._thread.finish()
        finally:
            self._thread.finish()  # Ctrl-C may have come before it began


class InThread(Generic[Running]):
    """
    The state that both threads share, so that it outlives the block.

    Ctrl-C comes before, in and between the calls of the main thread. So each step leaves a
    note before it does something; `finish` may be called at any time, and again. All
    waiting here uses bare locks: Ctrl-C in `threading.Thread.start`, or in any other that takes
    a Condition, may leave that locked for ever. So a third thread starts the one that serves.
    """

    def __init__(self, serving: Callable[[], AbstractAsyncContextManager[Running]]) -> None:
        self._serving = serving
        self._thread = threading.Thread(target=self._run, name="modbus server", daemon=True)
        self._is_starting = self._has_begun = False
        self._is_wanted = True
        # The main thread acquires each lock once; it is released when the awaited note is made.
        self._begun = _taken_lock()
        self._ready = _taken_lock()
        self._running: Running | None = None
        self._failure: BaseException | None = None
        self._stop: Callable[[], object] | None = None

    def start(self) -> Running:
        """
        Wait until the thread serves.

        Raises:
            the exception that prevented this.
        """
        self._is_starting = True
        try:
            _thread.start_new_thread(self._begin, ())
        except RuntimeError:
            self._is_starting = False
            raise
        self._ready.acquire()
        if self._running is None:
            self._raise_failure()
        assert self._running is not None
        return self._running

    def finish(self) -> None:
        """
        Wait until the thread has ended; Ctrl-C is raised only then.

        Raises:
            the exception that ended the server before.
        """
        try:
            self._end()
        except BaseException:
            self.finish()
            raise
        self._raise_failure()

    def _raise_failure(self) -> None:
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def stop(self) -> None:
        """Let the server end, without waiting."""
        self._is_wanted = False
        if self._stop is not None:
            self._stop()

    def _end(self) -> None:
        self.stop()
        if not self._is_starting:
            return
        if not self._has_begun:
            self._begun.acquire()
        if self._thread.ident not in (None, threading.get_ident()):  # a hook cannot wait for it
            self._thread.join()

    def _begin(self) -> None:
        try:
            self._thread.start()
        except RuntimeError as error:  # there are too many threads
            self._failure = error
            self._ready.release()
        finally:
            self._has_begun = True
            self._begun.release()

    def _run(self) -> None:
        try:
            with asyncio.Runner() as runner:
                runner.get_loop()  # the system may refuse this, before there is a coroutine
                runner.run(self._serve())
        except asyncio.CancelledError:
            pass
        except BaseException as error:
            self._failure = error
            if self._running is not None:
                logger.error("the server has ended: %r", error)
            elif isinstance(error, OSError) and not isinstance(error, ModbusError):
                self._failure = _cannot_serve(error)
        if self._running is None:
            self._ready.release()

    async def _serve(self) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._stop = partial(_cancel, asyncio.get_running_loop(), task)
        if self._is_wanted:  # else the main thread may not know yet that the server can be stopped
            async with self._serving() as running:
                self._running = running
                self._ready.release()
                await asyncio.Event().wait()


def _cannot_serve(error: OSError) -> ModbusConnectionError:
    """Return the error for a resource that the system refused to the event loop or the server."""
    made = ModbusConnectionError(f"cannot serve: {error.strerror or error}", errno=error.errno)
    made.__cause__ = error
    return made


def _taken_lock() -> threading.Lock:
    lock = threading.Lock()
    lock.acquire()
    return lock


def _cancel(loop: asyncio.AbstractEventLoop, task: asyncio.Task[None]) -> None:
    with contextlib.suppress(RuntimeError):  # the server has ended by itself
        loop.call_soon_threadsafe(task.cancel)
