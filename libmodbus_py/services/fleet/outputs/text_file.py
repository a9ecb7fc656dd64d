"""
A file, or the standard output, written to by a thread: a disk or a reader that is slow stops
nobody else.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import queue
import stat
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from ....protocol.mistakes import WrongType
from ..buffer import MOST_KEPT
from ..readings import Reading
from .output import OutputError

__all__ = ["TextFile"]

# Who does not read any more is left behind; the thread ends with the program.
LAST_WAIT = 1.0

Job = tuple[Callable[..., Any], tuple[Any, ...], asyncio.Future[Any]]


class TextFile:
    """
    Args:
        name: of the output.
        path: where readings are appended; "-" for the standard output.
        form: makes bytes of readings.
        header: what an empty file begins with.
        buffer: readings that wait, at most.

    Raises:
        TypeError: `path` is no text.
    """

    def __init__(
        self,
        name: str,
        path: str,
        form: Callable[[Sequence[Reading]], bytes],
        header: bytes = b"",
        buffer: int = MOST_KEPT,
    ) -> None:
        if not isinstance(path, str | os.PathLike) or not os.fspath(path):
            raise WrongType("path", f"must be text, not {path!r}")
        self.path: str = os.fspath(path)
        self.buffer: int = buffer
        self._name = name
        self._form = form
        self._header = header
        self._descriptor = -1
        self._jobs: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None

    @property
    def name(self) -> str:
        return self._name if self.path == "-" else f"{self._name} {self.path}"

    async def open(self) -> None:
        self._jobs = queue.SimpleQueue()
        thread = threading.Thread(
            target=_work, args=(self._jobs,), name=f"writes {self.path}", daemon=True
        )
        try:
            thread.start()
        except RuntimeError as error:  # there are too many
            raise OSError(errno.EAGAIN, str(error), self.path) from error
        self._thread = thread
        await self._have_done(self._open)

    async def write(self, readings: Sequence[Reading]) -> None:
        await self._have_done(self._write, self._form(readings))

    async def close(self) -> None:
        if self._thread is None:
            return
        with contextlib.suppress(OSError, TimeoutError, OutputError):
            await asyncio.wait_for(self._have_done(self._close), LAST_WAIT)
        self._jobs.put(None)
        self._thread = None

    async def _have_done(self, function: Callable[..., Any], *arguments: Any) -> None:
        done = asyncio.get_running_loop().create_future()
        self._jobs.put((function, arguments, done))
        await done

    # --- in the thread ----------------------------------------------------------------------

    def _open(self) -> None:
        with self._named():
            if self.path == "-":
                self._descriptor = os.dup(1)
            else:
                flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC
                self._descriptor = os.open(self.path, flags, 0o666)
            if not self._size:
                self._put(self._header)

    def _write(self, data: bytes) -> None:
        before = self._size
        with self._named():
            try:
                self._put(data)
            except OSError:
                if before is not None:  # else the rest of a line would begin the next one
                    with contextlib.suppress(OSError):
                        os.ftruncate(self._descriptor, before)
                raise

    @contextlib.contextmanager
    def _named(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            if self.path == "-":
                raise OutputError(f"standard output: {error.strerror}") from error
            raise OSError(error.errno, error.strerror, self.path) from error

    def _put(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            rest = rest[os.write(self._descriptor, rest) :]

    @property
    def _size(self) -> int | None:
        """Of a file; None for what has none."""
        state = os.fstat(self._descriptor)
        return state.st_size if stat.S_ISREG(state.st_mode) else None

    def _close(self) -> None:
        if self._descriptor >= 0:
            descriptor, self._descriptor = self._descriptor, -1
            os.close(descriptor)


def _work(jobs: queue.SimpleQueue[Job | None]) -> None:
    while (job := jobs.get()) is not None:
        function, arguments, done = job
        try:
            function(*arguments)
        except BaseException as error:
            _tell(done, error)
        else:
            _tell(done, None)


def _tell(done: asyncio.Future[Any], error: BaseException | None) -> None:
    with contextlib.suppress(RuntimeError):  # the loop is over
        done.get_loop().call_soon_threadsafe(_settle, done, error)


def _settle(done: asyncio.Future[Any], error: BaseException | None) -> None:
    if done.done():
        return
    if error is None:
        done.set_result(None)
    else:
        done.set_exception(error)
