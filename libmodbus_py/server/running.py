"""
Servers in a thread of their own, and programs that serve until a signal.

A thread ends even if Ctrl-C comes anywhere in the starting thread. Whatever that leaves undone, the
server ends when its `Background` is forgotten, because the thread does not refer to it. All waiting
uses bare locks: Ctrl-C in a method that takes a Condition, such as `threading.Thread.start`, may
leave that locked for ever; so a third thread starts the one that serves.
"""

from __future__ import annotations

import _thread
import asyncio
import contextlib
import gc
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractAsyncContextManager
from typing import Generic, TypeVar

from ..ports.hosts import reason
from ..protocol.errors import ModbusConnectionError
from ..protocol.logs import HarmlessLogger

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
        self._thread = ServingThread(serving)

    def __enter__(self) -> Running:
        """
        Raises:
            RuntimeError: it was entered before.
        """
        return self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._thread.finish()

    def __del__(self) -> None:
        # This waits for nothing: the server's thread may wait for a lock, such as a mapping's,
        # that is held where the garbage collector runs.
        if (thread := vars(self).get("_thread")) is not None:
            thread.stop()


class ServingThread(Generic[Running]):
    """A thread that serves until it is stopped."""

    def __init__(self, serving: Callable[[], AbstractAsyncContextManager[Running]]) -> None:
        self._serving = serving
        self._thread = threading.Thread(target=self._run, name="modbus server", daemon=True)
        self._process: int | None = None  # in which it was started: a forked child has no thread
        self._is_wanted = True
        self._task: asyncio.Task[None] | None = None  # once the thread has a loop
        self._running: Running | None = None
        self._failure: BaseException | None = None
        self._is_over = False
        self._ready, self._ended = _thread.allocate_lock(), _thread.allocate_lock()
        self._ready.acquire()
        self._ended.acquire()

    def start(self) -> Running:
        """
        Wait until the thread serves.

        Raises:
            RuntimeError: it was started before, or there are too many threads.
            the exception that prevented this.
        """
        if self._process is not None or not self._is_wanted:
            raise RuntimeError("this server runs, or did so before: call background() again")
        try:
            self._process = os.getpid()
            _thread.start_new_thread(self._begin, ())
            self._ready.acquire()
        except BaseException as error:
            if isinstance(error, RuntimeError):
                self._process = None
            self.finish()
            raise
        if self._running is None:
            self.finish()
        assert self._running is not None
        return self._running

    def finish(self) -> None:
        """
        Wait until the thread has ended; Ctrl-C is raised only then.

        Raises:
            the exception that ended the server before.
        """
        self.stop()
        is_here = self._process == os.getpid()
        if is_here and self._thread.ident != threading.get_ident():  # a hook cannot wait for it
            try:
                # From Python 3.14 on, Ctrl-C may come when the lock is taken and the block not
                # entered, so that it stays locked.
                if not self._is_over:
                    with self._ended:
                        pass
            except BaseException:
                self.finish()
                raise
            if self._thread.ident is not None:
                self._thread.join()
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def stop(self) -> None:
        """Let the server end, without waiting."""
        self._is_wanted = False
        if self._task is not None:
            with contextlib.suppress(RuntimeError):  # it has ended by itself
                self._task.get_loop().call_soon_threadsafe(self._task.cancel)

    def _begin(self) -> None:
        try:
            self._thread.start()
        except RuntimeError as error:  # there are too many threads
            self._failure = error
            self._ready.release()
            self._end()

    def _end(self) -> None:
        self._is_over = True
        self._ended.release()

    def _run(self) -> None:
        try:
            runner = asyncio.Runner()
            try:
                runner.get_loop()  # before there is a coroutine
            except OSError as error:
                text = f"cannot serve: {reason(error)}"
                raise ModbusConnectionError(text, errno=error.errno) from error
            with runner:
                runner.run(self._serve())
        except asyncio.CancelledError:
            pass
        except BaseException as error:
            self._failure = error
            if self._running is not None:
                logger.error("the server has ended: %r", error)
        if self._running is None:
            self._ready.release()
        self._end()

    async def _serve(self) -> None:
        self._task = asyncio.current_task()
        if self._is_wanted:  # else it was stopped before it could be told
            async with self._serving() as running:
                self._running = running
                self._ready.release()
                await asyncio.Event().wait()


# --- until a signal ------------------------------------------------------------------------------

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
