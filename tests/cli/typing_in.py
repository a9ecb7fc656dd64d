"""
What is typed, and what comes of it: in this process where nothing else is needed.
"""

from __future__ import annotations

import contextlib
import io
import os
import pty
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

from libmodbus_py.cli.main import main

PROGRAM = [sys.executable, "-m", "libmodbus_py"]


class Done(NamedTuple):
    """How a command ended."""

    code: int
    out: str
    err: str


def typed(*arguments: str) -> Done:
    """Run a command here."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(arguments)
        except SystemExit as ended:
            code = int(ended.code or 0)
    return Done(code, out.getvalue(), err.getvalue())


class Terminal:
    """A command on a terminal of its own; stderr, too."""

    def __init__(self, arguments: list[str], environment: dict[str, str], columns: int) -> None:
        self.output = ""
        self._master, slave = pty.openpty()
        surroundings = dict(os.environ)
        for size in ("COLUMNS", "LINES"):
            surroundings.pop(size, None)
        termios.tcsetwinsize(slave, (24, columns))
        self.process = subprocess.Popen(
            [*PROGRAM, *arguments],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            env={**surroundings, "TERM": "xterm", **environment},
            start_new_session=True,
        )
        os.close(slave)
        os.set_blocking(self._master, False)

    def resize(self, columns: int, rows: int = 24) -> None:
        termios.tcsetwinsize(self._master, (rows, columns))

    def until(self, holds: Callable[[str], bool], seconds: float = 20.0) -> str:
        """Wait for something in what was shown; gives all of it."""
        limit = time.monotonic() + seconds
        while not holds(self.output):
            assert time.monotonic() < limit, self.output
            with contextlib.suppress(BlockingIOError, OSError):
                self.output += os.read(self._master, 65536).decode(errors="replace")
            time.sleep(0.01)
        return self.output

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self._master)


@contextlib.contextmanager
def on_terminal(
    *arguments: str, columns: int = 80, environment: dict[str, str] | None = None
) -> Iterator[Terminal]:
    terminal = Terminal(list(arguments), environment or {}, columns)
    try:
        yield terminal
    finally:
        terminal.close()
