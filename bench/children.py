"""
Child processes: C programs compiled, servers and clients started, what they use.

No child outlives this program, and nobody waits for one for longer than `PATIENCE`.
"""

from __future__ import annotations

import ctypes
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

HERE = Path(__file__).parent
# Seconds that a child may take beyond the time it was told to.
PATIENCE = 40
# Descriptors that a server may open for itself when its first client connects.
SPARE = 8
PR_SET_PDEATHSIG = 1
LIBC = ctypes.CDLL(None)


class Failed(Exception):
    """A child did not do what it was told; the message says why."""


def compile_all(folder: Path) -> None:
    """Compile every C program here into `folder`."""
    for source in HERE.glob("*.c"):
        command = ["gcc", "-O2", "-Wall", "-Wextra", "-o", folder / source.stem, source]
        subprocess.run([*command, "-lmodbus"], check=True)


def python(program: str, *arguments: str, interpreter: str = sys.executable) -> list[str]:
    """Return the command for a program in Python here."""
    return [interpreter, str(HERE / program), *arguments]


def die_with_parent() -> None:
    LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


class Child:
    """A process that talks in lines: a server tells its place, a client takes orders."""

    def __init__(self, command: list[str]) -> None:
        # A file, because a full pipe that nobody reads would stop the child.
        self._complaints = tempfile.TemporaryFile("w+", errors="replace")  # noqa: SIM115
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._complaints,
            text=True,
            bufsize=1,
            preexec_fn=die_with_parent,
        )
        self.pid = self._process.pid

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._complaints.close()

    def stop(self) -> None:
        self._process.kill()
        self._process.communicate()

    @property
    def is_alive(self) -> bool:
        return self._process.poll() is None

    def read_line(self, patience: float = PATIENCE) -> str:
        """Return the next line; there is never more than one under way."""
        assert self._process.stdout is not None
        ready, _, _ = select.select([self._process.stdout], [], [], patience)
        if not ready:
            self.stop()
            raise Failed(f"did nothing for {patience:.0f} s")
        line = self._process.stdout.readline()
        if not line:
            self._process.wait()
            raise Failed(self._last_words())
        return line.strip()

    def order(self, line: str, patience: float = PATIENCE) -> Any:
        """Send a line, give the answer."""
        if not self.is_alive:
            raise Failed(self._last_words())
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        return json.loads(self.read_line(patience))

    def _last_words(self) -> str:
        self._complaints.seek(0)
        lines = self._complaints.read().strip().splitlines()
        return lines[-1] if lines else f"ended with status {self._process.returncode}"


def run(command: list[str], patience: float = PATIENCE) -> Any:
    """Run a program to its end, and return the JSON that it printed."""
    try:
        output = subprocess.run(
            command,
            stdout=subprocess.PIPE,
            timeout=patience,
            check=True,
            preexec_fn=die_with_parent,
        ).stdout
    except subprocess.SubprocessError as error:
        raise Failed(str(error)) from error
    return json.loads(output)


# --- what a process uses ------------------------------------------------------------------


def processor_time(pid: int) -> float:
    """Return the seconds of processor time of all threads, user and system time."""
    clock = ctypes.c_int()
    if LIBC.clock_getcpuclockid(pid, ctypes.byref(clock)) != 0:
        raise Failed("the server died")
    return time.clock_gettime(clock.value)


def resident_memory(pid: int) -> int:
    """Return the bytes in memory."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def wait_until_idle(pid: int, descriptors: int) -> None:
    """Wait, not for ever, until a server has seen its clients off."""
    end = time.monotonic() + 2
    while time.monotonic() < end:
        if len(os.listdir(f"/proc/{pid}/fd")) <= descriptors + SPARE:
            return
        time.sleep(0.002)


@contextmanager
def on_one_processor(*pids: int) -> Iterator[None]:
    """Keep processes on the same processor for a while."""
    allowed = os.sched_getaffinity(0)
    for pid in pids:
        os.sched_setaffinity(pid, {min(allowed)})
    try:
        yield
    finally:
        for pid in pids:
            os.sched_setaffinity(pid, allowed)
