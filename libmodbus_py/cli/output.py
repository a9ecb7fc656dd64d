"""
Standard output and standard error: messages, JSON and styles.
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
    from collections.abc import Iterator
    from typing import Any, TextIO

# fmt: off
__all__ = [
    "PROGRAM", "abandon", "complain", "counted", "harmless", "inform", "log_line", "prepare",
    "print_json", "print_log_lines", "styled", "written_to",
]
# fmt: on

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
    """Return what a stream cannot encode as escapes that JSON has, too, such as ``\\u00fc``."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    units = error.object[error.start : error.end].encode("utf-16-be", "surrogatepass")
    escapes = (f"\\u{units[at : at + 2].hex()}" for at in range(0, len(units), 2))
    return "".join(escapes), error.end


def abandon() -> None:
    """Discard the buffered output and all that follows; writing it at exit would fail again."""
    with contextlib.suppress(OSError, ValueError):
        printed = sys.stdout.fileno()
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, printed)
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
    if text.isprintable():  # mostly, and then nothing else needs to be imported
        return text
    from ..protocol.plain import without_controls

    return without_controls(text)


def print_json(fields: dict[str, Any]) -> None:
    """Print an object of JSON as one line, at once."""
    from ..protocol.json_text import json_line

    print(json_line(fields), flush=True)


@contextlib.contextmanager
def written_to(path: str | None) -> Iterator[None]:
    """
    Write all that is printed to a new file while the block runs; print it if there is no path.

    A file in which nothing was written does not remain, so that the command can be repeated. An
    OSError names the file, which ends with a whole line.
    """
    if path is None:
        yield
        return
    try:
        raw = _File(path, "x")
    except FileExistsError:
        raise ValueError(f"{path} exists, and would be overwritten") from None
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

    _whole_lines = 0  # bytes

    def write(self, data: Any) -> int:
        begin = self.tell()
        try:
            count: int = super().write(data)
        except OSError as error:
            with contextlib.suppress(OSError):
                self.truncate(self._whole_lines)
            raise OSError(error.errno, error.strerror, self.name) from None
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
