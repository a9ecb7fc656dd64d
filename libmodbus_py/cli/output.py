"""
Standard output and standard error: messages, JSON and styles; and, on a terminal, work that goes
on: a status line, lines that are drawn again in place, progress.
"""

from __future__ import annotations

import codecs
import contextlib
import io
import os
import sys
import time

TYPE_CHECKING = False  # see commands
if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from typing import Any, TextIO

    from ..tools.scan.scan import Progress
    from ..tools.scan.search import Extent, Searching

PROGRAM = "libmodbus-py"

ERROR = "1;31"
"""Style of the name of the program before an error: bold and red."""

_prints_log_lines = False


def prepare() -> None:
    """Make both streams accept everything that is printed, even if closed or limited to ASCII."""
    codecs.register_error("json", _escaped)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # the descriptor was closed when the program started
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 (never closed)
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="json")


def _escaped(error: UnicodeError) -> tuple[str, int]:
    """Return text with escapes as in JSON, ``\\u00fc``, for characters that the stream lacks."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    units = error.object[error.start : error.end].encode("utf-16-be", "surrogatepass")
    escapes = (f"\\u{units[at : at + 2].hex()}" for at in range(0, len(units), 2))
    return "".join(escapes), error.end


def abandon() -> None:
    """Discard the buffered output and all later output; writing it at exit would fail again."""
    with contextlib.suppress(OSError, ValueError):
        descriptor = sys.stdout.fileno()
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, descriptor)
        os.close(nowhere)


def print_log_lines(*, is_on: bool) -> None:
    """From now on, `inform` and `complain` print lines as --log-format json has them, or not."""
    global _prints_log_lines
    _prints_log_lines = is_on


def log_line(seconds: float, level: str, logger: str, message: str, exception: str = "") -> str:
    """Return one line of a log in JSON, without the newline."""
    from ..protocol.json_text import json_line
    from ..protocol.plain import time_text

    entry = {"time": time_text(seconds), "level": level, "logger": logger, "message": message}
    return json_line({**entry, "exception": exception} if exception else entry)


def inform(text: str, to: TextIO | None = None) -> None:
    """Print a line about what the command does, to stdout or another stream."""
    if _prints_log_lines:
        text = log_line(time.time(), "info", "libmodbus_py.cli", text)
    print(text, file=to, flush=True)


def complain(text: str, level: str = "error") -> None:
    """Print a message to stderr, after the name of the program, which may be red."""
    if _prints_log_lines:
        text = log_line(time.time(), level, "libmodbus_py.cli", text)
    else:
        text = f"{styled(f'{PROGRAM}:', ERROR, sys.stderr)} {harmless(text)}"
    print(text, file=sys.stderr, flush=True)


def harmless(text: str) -> str:
    """Return a message without characters that control a terminal."""
    if text.isprintable():  # most texts are printable, so that nothing else needs to be imported
        return text
    from ..protocol.plain import without_controls

    return without_controls(text)


def print_json(fields: dict[str, Any]) -> None:
    """Print an object of JSON as one line, at once."""
    from ..protocol.json_text import json_line

    print(json_line(fields), flush=True)


def print_csv(rows: Iterable[Iterable[Any]]) -> None:
    """Print rows as CSV at once; on a terminal without characters that control it."""
    from ..files.csv_text import csv_rows

    text = csv_rows(rows)
    print(harmless(text) if sys.stdout.isatty() else text, end="", flush=True)


@contextlib.contextmanager
def written_to(path: str | None, *, goes_on: bool = False) -> Iterator[None]:
    """
    Write all that is printed to a new file while the block runs; print it if there is no path.

    A file in which nothing was written does not remain, so that the command can be repeated. An
    OSError names the file, which ends with a whole line. With `goes_on`, what is printed is added
    to a regular file that exists.
    """
    if path is None:
        yield
        return
    try:
        raw = _File(path, "x")
    except FileExistsError:
        if not (goes_on and os.path.isfile(path)):
            raise ValueError(f"{path} exists, and would be overwritten") from None
        raw = _File(path, "a")
    file = io.TextIOWrapper(io.BufferedWriter(raw), encoding="utf-8", newline="")
    try:
        with file, contextlib.redirect_stdout(file):
            yield
            file.flush()
    finally:
        with contextlib.suppress(OSError):
            if not os.path.getsize(path):
                os.unlink(path)


class _File(io.FileIO):
    """A file whose errors name it, and that loses the line which does not fit on a full disk."""

    def __init__(self, path: str, mode: str) -> None:
        super().__init__(path, mode)
        self._whole_lines = self.tell()  # bytes
        self._failure: OSError | None = None

    def write(self, data: Any) -> int:
        if self._failure is not None:  # after a line that was cut off, nothing may follow
            raise self._failure
        begin = self.tell()
        try:
            count: int = super().write(data)
        except OSError as error:
            with contextlib.suppress(OSError):
                self.truncate(self._whole_lines)
            self._failure = OSError(error.errno, error.strerror, self.name)
            raise self._failure from None
        end = bytes(data[:count]).rfind(b"\n") + 1
        self._whole_lines = begin + end if end else self._whole_lines
        return count


def styled(text: str, style: str, stream: TextIO | None = None) -> str:
    """
    Return a text with a style, if `stream`, or else stdout, is a terminal whose user wants styles
    (https://no-color.org): SGR parameters, such as "1" for bold; empty for none.
    """
    is_plain = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    has_styles = (stream or sys.stdout).isatty() and not is_plain
    return f"\x1b[{style}m{text}\x1b[0m" if style and has_styles else text


def counted(number: int, noun: str) -> str:
    """Return a number and a noun, such as "1 point" or "2 points"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


# --- work that goes on --------------------------------------------------------------------------


REDRAWN_S = 0.1
"""Between two states of the status line, at least: faster is unreadable, and costs time."""


class Status:
    """A line on standard error that is drawn again in place, at first `after` seconds."""

    def __init__(self, after: float = 0.0) -> None:
        self._is_wanted = sys.stderr.isatty()
        self._is_shown = False
        self._next = time.monotonic() + after

    def show(self, text: str) -> None:
        """Draw a text, unless one was drawn a moment before."""
        now = time.monotonic()
        if not self._is_wanted or now < self._next:
            return
        self._next = now + REDRAWN_S
        self._is_shown = True
        fitting = text[: _size().columns - 1]
        print(f"\r{fitting}\x1b[K", end="", file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Remove the line, before other output."""
        if self._is_shown:
            self._is_shown = False
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)


class RedrawnLines:
    """Draws lines on a terminal over those that were drawn before, within its current size."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._drawn: list[str] = []

    def draw(self, lines: Sequence[tuple[str, bool]]) -> None:
        """Draw the lines that fit on the terminal, each with True if it is bold."""
        columns, rows = _size()
        room = max(1, rows - 1)
        if len(lines) > room:
            more = len(lines) - room + 1
            lines = [*lines[: room - 1], (f"... {more} more", False)]
        fitting = [
            "".join(char if char.isprintable() else "?" for char in line) for line, _ in lines
        ]
        lines_drawn = [line[: max(1, columns - 1)] for line in fitting]
        text = "\n".join(
            styled(line, "1" if is_bold else "", self._stream)
            for line, (_, is_bold) in zip(lines_drawn, lines, strict=True)
        )
        self._stream.write(f"{self._back(columns)}{text}\n")
        self._stream.flush()
        self._drawn = lines_drawn

    def clear(self) -> None:
        """Remove the lines, before other output."""
        if self._drawn:
            self._stream.write(self._back(_size().columns))
            self._stream.flush()
            self._drawn = []

    def _back(self, columns: int) -> str:
        """Return the sequence that moves to the first line and clears all lines."""
        height = sum(max(1, -(-len(line) // columns)) for line in self._drawn)
        return f"\x1b[{height}A\r\x1b[J" if height else ""


def _size() -> os.terminal_size:
    import shutil  # imports three compressors, which a pipe does not need

    return shutil.get_terminal_size()


def progress(state: Progress | Searching, count: int = 0) -> str:
    """Return the progress of a scan, which has `found` units, or of a search as one line."""
    from ..tools.scan.search import Searching

    if isinstance(state, Searching):
        table = state.table.replace("_", " ")
        return f"unit {state.unit}, {table}: request {state.requests} of {state.most_requests}"
    return (
        f"{state.setting}: unit {state.unit}; {state.done} of {state.total} asked, {count} found, "
        f"{duration(state.left)} left at most"
    )


def missing(extent: Extent) -> str:
    """Return what a search may have missed in a table; empty if nothing."""
    parts = [f"ended by {extent.ended}"] * bool(extent.ended)
    if extent.unseen:
        parts.append(f"ranges of up to {extent.unseen} may have been missed")
    return ", ".join(parts)


def duration(seconds: float) -> str:
    """Return a number of seconds in words, such as "4.2 s" or "3 min 5 s"."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
