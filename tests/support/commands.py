"""
Commands of libmodbus-py, in three ways.

`run` calls the command line in this process: for what a command prints and how it ends.
`Started` gives a command a process of its own, forked from one that has imported everything:
for signals, pipes and terminals. `PROGRAM` starts an interpreter: for what happens at the start.
"""

import atexit
import contextlib
import ctypes
import io
import json
import logging
import os
import pty
import resource
import select
import signal
import socket
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple, Self, TextIO

from libmodbus_py.cli.main import main
from tests.support.leaks import note_lasting

PROGRAM = [sys.executable, "-m", "libmodbus_py"]

ROOT = Path(__file__).parents[2]

PAGE_TOKEN = {"LIBMODBUS_PY_PAGE_TOKEN": "Bookmarked-by_the-plant-2026"}
"""The environment of a command whose page has a known token."""

PATIENCE = 60.0  # seconds until a command that does not end is a failure

PR_SET_CHILD_SUBREAPER = 36


def page_url(line: str) -> str:
    """Return the URL of a page from the line that a command with `PAGE_TOKEN` printed about it."""
    assert line.startswith("page on http://127.0.0.1:")
    url = line.removeprefix("page on ").rstrip("\n")
    assert url.endswith("/?token=...")
    return url.replace("...", *PAGE_TOKEN.values())


class Result(NamedTuple):
    """How a command ended: its exit code, and what it printed."""

    code: int
    out: str
    err: str


def run(
    *arguments: object, out: TextIO | None = None, environment: Mapping[str, str] | None = None
) -> Result:
    """
    Call the command line in this process. `arguments`: as they are typed, without the name of the
    program; `out`: the standard output; None collects it; `environment`: variables beside those of
    this process.
    """
    printed, errors = _Collected(), _Collected()
    with (
        _as_a_program(environment or {}),
        contextlib.redirect_stdout(out or printed),
        contextlib.redirect_stderr(errors),
    ):
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as run_forked:
            code = int(run_forked.code or 0)
    return Result(code, printed.text(), errors.text())


class _Collected(io.TextIOWrapper):
    """A stream as programs have it, into memory."""

    def __init__(self) -> None:
        super().__init__(io.BytesIO(), encoding="utf-8", newline="\n", write_through=True)

    def text(self) -> str:
        self.seek(0)
        return self.read()


@contextlib.contextmanager
def _as_a_program(environment: Mapping[str, str]) -> Iterator[None]:
    """Keep what a program may change for itself: log handlers, variables, limits."""
    root = logging.getLogger()
    handlers, root.handlers = root.handlers, []
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    variables = dict(os.environ)
    os.environ.update(environment)
    try:
        yield
    finally:
        root.handlers = handlers
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
        os.environ.clear()
        os.environ.update(variables)


@cache
def _command_server() -> socket.socket:
    """Start the process that forks commands; it ends with this one."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        process = subprocess.Popen(
            [sys.executable, "-m", "tests.support.command_server", str(theirs.fileno())],
            cwd=ROOT,
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
        )

    note_lasting(ours.fileno(), process.pid)

    def end() -> None:
        ours.close()
        process.wait()

    atexit.register(end)
    return ours


def _fork(request: Mapping[str, object], descriptors: list[int]) -> int:
    """Fork a process for a command, and return its process id to the parent."""
    server = _command_server()
    prctl = ctypes.CDLL(None, use_errno=True).prctl
    prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    try:
        socket.send_fds(server, [json.dumps(request).encode()], descriptors)
        process = int(server.recv(100))
        assert server.recv(100) == b"adopted"
    finally:
        prctl(PR_SET_CHILD_SUBREAPER, 0, 0, 0, 0)
    return process


class Started:
    """
    A command in a process of its own, with the methods of `subprocess.Popen`. `stdin, stdout,
    stderr`: descriptors; None is a pipe for both outputs, and an empty input; `environment`:
    variables beside those of this process; `folder`: the command's; None is that of this process.
    `stdout, stderr`: the pipes; `returncode`: None while the command runs.
    """

    def __init__(
        self,
        *arguments: object,
        stdin: int | None = None,
        stdout: int | None = None,
        stderr: int | None = None,
        environment: Mapping[str, str] | None = None,
        folder: Path | None = None,
        new_session: bool = False,
    ) -> None:
        request = {
            "arguments": [str(argument) for argument in arguments],
            "environment": {**os.environ, **(environment or {})},
            "folder": str(folder or Path.cwd()),
            "new_session": new_session,
        }
        self.returncode: int | None = None
        with contextlib.ExitStack() as pipes:
            if stdin is None:
                stdin = pipes.enter_context(open(os.devnull)).fileno()
            self.stdout, stdout = _pipe(pipes, stdout)
            self.stderr, stderr = _pipe(pipes, stderr)
            self.pid = _fork(request, [stdin, stdout, stderr])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """End the command if it still runs."""
        self.kill()
        self.wait()
        self.stdout.close()
        self.stderr.close()

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def poll(self) -> int | None:
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, seconds: float = PATIENCE) -> int:
        """
        Wait until the command ends, and return its exit code; minus a signal's number. Raise
        `subprocess.TimeoutExpired`: the command still runs.
        """
        if self.poll() is None:
            descriptor = os.pidfd_open(self.pid)
            try:
                readable, _, _ = select.select([descriptor], [], [], seconds)
            finally:
                os.close(descriptor)
            if not readable:
                raise subprocess.TimeoutExpired(f"process {self.pid}", seconds)
        code = self.poll()
        assert code is not None
        return code

    def communicate(self, seconds: float = PATIENCE) -> tuple[str, str]:
        """Wait until the command ends, and return what it printed and nobody has read yet."""
        rest = {self.stdout: "", self.stderr: ""}

        def read(stream: TextIO) -> None:
            rest[stream] = stream.read()

        threads = [threading.Thread(target=read, args=(stream,)) for stream in rest]
        for thread in threads:
            thread.start()
        try:
            self.wait(seconds)
        except subprocess.TimeoutExpired:
            self.kill()
            raise
        finally:
            for thread in threads:
                thread.join()
        return rest[self.stdout], rest[self.stderr]


def run_forked(*arguments: object, stdout: int | None = None) -> Result:
    """Run a command to its end in a process of its own: for one that writes to descriptor 1."""
    with Started(*arguments, stdout=stdout) as process:
        out, err = process.communicate()
    return Result(process.wait(), out, err)


def _pipe(stack: contextlib.ExitStack, descriptor: int | None) -> tuple[TextIO, int]:
    """Return a stream to read from, which is empty if there is a descriptor, and where to write."""
    if descriptor is not None:
        return io.StringIO(), descriptor
    reading, writing = os.pipe()
    stack.callback(os.close, writing)
    return open(reading, encoding="utf-8", errors="replace"), writing


class Terminal:
    """
    A command whose input and outputs are a terminal. `stdout`: a descriptor in place of the
    terminal.
    """

    def __init__(
        self,
        arguments: tuple[object, ...],
        environment: Mapping[str, str],
        columns: int,
        stdout: int | None,
    ) -> None:
        self.output = ""
        self._master, slave = pty.openpty()
        termios.tcsetwinsize(slave, (24, columns))
        self.process = Started(
            *arguments,
            stdin=slave,
            stdout=slave if stdout is None else stdout,
            stderr=slave,
            environment={"TERM": "xterm", "COLUMNS": "", "LINES": "", **environment},
            new_session=True,
        )
        os.close(slave)

    def resize(self, columns: int, rows: int = 24) -> None:
        termios.tcsetwinsize(self._master, (rows, columns))

    def until(self, holds: Callable[[str], bool], seconds: float = PATIENCE) -> str:
        """Wait until this holds for what was shown so far, and return all of that."""
        limit = time.monotonic() + seconds
        while not holds(self.output):
            assert time.monotonic() < limit, self.output
            self.read(0.02)
        return self.output

    def read(self, seconds: float = PATIENCE) -> bool:
        """Wait for more output, and return False at its end."""
        if not select.select([self._master], [], [], seconds)[0]:
            return True
        try:
            self.output += os.read(self._master, 65536).decode(errors="replace")
        except OSError:  # no process has the terminal any more
            return False
        return True

    def read_to_end(self) -> str:
        """Wait until the command ends, and return all that it showed."""
        while self.read():
            pass
        return self.output

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self._master)


@contextlib.contextmanager
def on_terminal(
    *arguments: object,
    columns: int = 80,
    environment: Mapping[str, str] | None = None,
    stdout: int | None = None,
) -> Iterator[Terminal]:
    terminal = Terminal(arguments, environment or {}, columns, stdout)
    try:
        yield terminal
    finally:
        terminal.close()
