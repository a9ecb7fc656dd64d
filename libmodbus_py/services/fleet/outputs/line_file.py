"""
Outputs to files and to the standard output: lines of JSON, rows of CSV, or lines of another format.
A thread writes them, so that a slow disk or reader delays nothing else.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import stat
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import BinaryIO, NamedTuple

from ....files.csv_text import csv_rows
from ....protocol.mistakes import WrongType, WrongValue
from ....protocol.plain import without_controls
from ....system import open_file
from ...tasks import WriterThread, finish
from ..readings import MOST_KEPT, Reading
from .forms import COLUMNS, as_csv, as_json
from .output import Output, OutputError, file_at

# Bytes that are read at once from a file whose last line was not ended.
CHUNK_BYTES = 1 << 20


class Format(NamedTuple):
    """
    A format of lines. Each file begins with `begin`, the header or the beginning of each line; text
    that is enclosed by `quote` may have several lines.
    """

    name: str
    lines: Callable[[Sequence[Reading]], bytes]
    begin: bytes
    header: bytes = b""
    quote: bytes = b""


class LineFile(Output):
    """
    An output that appends readings to a file, or to the standard output ("-").

    A file that does not begin as the format demands is left as it is: its content is not readings,
    or readings with other columns. A file that was renamed or deleted is opened anew by its path,
    as after logrotate; one that was emptied gets the header again. If a program or a machine
    stopped in the midst of a line, that line is ended first.
    """

    def __init__(self, path: str, form: Format, buffer: int = MOST_KEPT) -> None:
        if not isinstance(path, str | os.PathLike) or not os.fspath(path):
            raise WrongType("path", f"must be text, not {path!r}")
        self.path: str = os.fspath(path)
        if "\0" in self.path:
            raise WrongValue("path", "must not contain the character 0")
        # True if readings of earlier runs are not wanted.
        self.is_live: bool = self.path == "-"
        self.name: str = form.name if self.is_live else f"{form.name} {self.path}"
        thing = "the standard output" if self.is_live else file_at(self.path)
        self.exclusive: tuple[str, ...] = (thing,)
        self.buffer: int = buffer
        self._form = form
        self._descriptor = -1
        self._is_terminal = False
        self._thread = WriterThread(self.path)

    @property
    def identity(self) -> str:
        """The name of its place in a journal, the same in whatever folder the program starts."""
        return f"{self._form.name} {os.path.abspath(self.path)}"

    async def open_output(self) -> None:
        self._thread.start()
        await self._thread.call(self._open)

    async def write_readings(self, readings: Sequence[Reading]) -> None:
        await self._thread.call(self._write, self._form.lines(readings))

    async def close_output(self) -> None:
        if not self._thread.is_running:
            return
        try:
            await finish(self._thread.call(self._close))  # a reader may have stopped reading
        finally:
            self._thread.stop()

    # --- in the thread ----------------------------------------------------------------------

    def _open(self) -> None:
        with self._named():
            if self.is_live:
                self._descriptor = os.dup(1)
            else:
                flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC
                self._descriptor = os.open(self.path, flags, 0o666)
            self._is_terminal = os.isatty(self._descriptor)
            self._put_whole(self._begin())

    def _write(self, data: bytes) -> None:
        with self._named():
            if self._is_terminal:
                data = without_controls(data.decode()).encode()
            if self._is_replaced():
                self._close()
                self._open()
            elif self._size == 0:
                self._put_whole(self._form.header)
            self._put_whole(data)

    def _is_replaced(self) -> bool:
        """True if the path leads to another file than the open one, or to none."""
        if self.is_live:
            return False
        try:
            return not os.path.samestat(os.stat(self.path), os.fstat(self._descriptor))
        except FileNotFoundError:
            return True

    def _begin(self) -> bytes:
        """Return what must stand before the first reading."""
        if not self._size:
            return self._form.header
        if self.is_live:
            return b""
        try:
            file = open_file(self.path)
        except OSError:  # this user may only write it
            return b""
        with file:
            if file.read(len(self._form.begin)) != self._form.begin:
                head = self._form.begin.decode().strip()
                reason = f"does not begin with {head!r}, so nothing is written; rename the file"
                raise OSError(errno.EEXIST, reason)
            file.seek(-1, os.SEEK_END)
            if file.read(1) == b"\n":
                return b""
            return self._form.quote * self._is_quoting(file) + b"\n"

    def _is_quoting(self, file: BinaryIO) -> bool:
        """Return True if a file ends within a quoted text."""
        if not self._form.quote:
            return False
        file.seek(0)
        chunks = iter(lambda: file.read(CHUNK_BYTES), b"")
        return sum(chunk.count(self._form.quote) for chunk in chunks) % 2 == 1

    def _put_whole(self, data: bytes) -> None:
        """Write all of the data, or nothing to a file that has no room."""
        before = self._size
        try:
            self._put(data)
        except OSError:
            if before is not None:  # else the rest of a line would begin the next one
                with contextlib.suppress(OSError):
                    os.ftruncate(self._descriptor, before)
                    os.lseek(self._descriptor, 0, os.SEEK_END)
            raise

    @contextlib.contextmanager
    def _named(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            if self.is_live:
                raise OutputError(f"standard output: {error.strerror}") from error
            raise OSError(error.errno, error.strerror, self.path) from error

    def _put(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            try:
                rest = rest[os.write(self._descriptor, rest) :]
            except BlockingIOError:  # another program made a shared pipe or terminal non-blocking
                select.select([], [self._descriptor], [])

    @property
    def _size(self) -> int | None:
        """The size of the file in bytes; None for pipes and terminals."""
        state = os.fstat(self._descriptor)
        return state.st_size if stat.S_ISREG(state.st_mode) else None

    def _close(self) -> None:
        if self._descriptor >= 0:
            descriptor, self._descriptor = self._descriptor, -1
            os.close(descriptor)


class JsonOutput(LineFile):
    """Appends lines of JSON: device, name, time, value, unit, quality, and reason, id, labels."""

    def __init__(self, path: str = "-", buffer: int = MOST_KEPT) -> None:
        super().__init__(path, Format("json", as_json, b'{"device": '), buffer)


class CsvOutput(LineFile):
    """Appends rows of CSV, with a column for each of these labels; a new file begins with names."""

    def __init__(
        self, path: str = "-", buffer: int = MOST_KEPT, labels: Sequence[str] = ()
    ) -> None:
        columns = _columns(labels)
        header = csv_rows([(*COLUMNS, *columns)]).encode()
        lines = partial(as_csv, labels=columns)
        super().__init__(path, Format("csv", lines, header, header, quote=b'"'), buffer)


def _columns(labels: object) -> list[str]:
    if isinstance(labels, str) or not isinstance(labels, Sequence):
        raise WrongType("labels", f"must be a list of names, not {labels!r}")
    for at, name in enumerate(labels):
        if not isinstance(name, str) or not name:
            raise WrongType(("labels", at), f"must be text, not {name!r}")
        if name in COLUMNS or name in labels[:at]:
            raise WrongValue.about(("labels", at), f"there is a column {name!r} already")
    return [*labels]
