"""
A terminal that closes ends what was started in it; SIGHUP from somebody else does not. While a
command starts, what it reads is read again as soon as it has started, or it ends if its terminal
was closed.
"""

from __future__ import annotations

import contextlib
import os
import pty
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.commands import Started as Forked
from tests.support.peers import until

FILES = {
    "serve.toml": "[[unit]]\nid = 1\n[[unit.holding_registers]]\naddress = 0\nvalue = 1\n",
    "gateway.toml": 'listen = ["tcp://127.0.0.1:0"]\n[[route]]\nto = "tcp://127.0.0.1:1"\n',
    "poll.toml": '[[device]]\nname = "a"\nurl = "tcp://127.0.0.1:1"\nmap = "map.csv"\n',
    "map.csv": "name,table,address\nx,holding_registers,0\n",
}

# How to begin, and what is said when the file is read again.
COMMANDS = {
    "serve": (["tcp://127.0.0.1:0", "--device", "serve.toml"], "serve.toml"),
    "gateway": (["--config", "gateway.toml"], "gateway.toml"),
    "poll": (["poll.toml"], "poll.toml: read again, 1 device"),
}

# Has its standard input for a terminal, as what is started in one has.
BEGIN = (
    "import fcntl, os, signal, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); "
    "signal.signal(signal.SIGHUP, signal.SIG_IGN if sys.argv[1] == 'nohup' else signal.SIG_DFL); "
    "os.execv(sys.executable, [sys.executable, *sys.argv[2:]])"
)


class Started:
    """
    A command in a terminal of its own, until that is closed.

    Attributes:
        program: what Python runs.
        master: the terminal's other end.
    """

    program: tuple[str, ...] = ("-m", "libmodbus_py")

    def __init__(self, folder: Path, name: str, how: str = "") -> None:
        for file, text in FILES.items():
            (folder / file).write_text(text)
        self._log = folder / "log"
        self.master, slave = pty.openpty()
        with open(self._log, "wb") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-c", BEGIN, how, *self.program, name, *COMMANDS[name][0]],
                cwd=folder,
                stdin=slave,
                stdout=log,
                stderr=log,
                start_new_session=True,
                env={**os.environ, "PYTHONUNBUFFERED": "1"},
            )
        os.close(slave)

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        with contextlib.suppress(OSError):
            os.close(self.master)

    @property
    def said(self) -> str:
        return self._log.read_text()

    def hang_up(self, name: str) -> None:
        """Send SIGHUP, and wait until the file was read again."""
        before = self.said.count(COMMANDS[name][1])
        self.process.send_signal(signal.SIGHUP)
        until(lambda: self.said.count(COMMANDS[name][1]) > before)


@contextlib.contextmanager
def started(folder: Path, name: str, how: str = "") -> Iterator[Started]:
    made = Started(folder, name, how)
    try:
        # Where SIGHUP has its meaning: bit 0 of what is caught.
        until(lambda: catches_hangup(made.process.pid))
        yield made
    finally:
        made.close()


def catches_hangup(process: int) -> bool:
    text = Path(f"/proc/{process}/status").read_text()
    return bool(int(text.partition("SigCgt:")[2].split()[0], 16) & 1)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_terminal_that_closes_ends_it(tmp_path: Path, name: str) -> None:
    with started(tmp_path, name) as command:
        command.hang_up(name)
        assert command.process.poll() is None
        os.close(command.master)
        assert command.process.wait(20) == 0
        assert "Traceback" not in command.said


@pytest.mark.parametrize("name", COMMANDS)
def test_under_nohup_it_goes_on(tmp_path: Path, name: str) -> None:
    with started(tmp_path, name, "nohup") as command:
        os.close(command.master)
        command.hang_up(name)
        command.hang_up(name)
        assert command.process.poll() is None
        command.process.terminate()
        assert command.process.wait(20) == 0


NAMES = pytest.mark.parametrize("name", COMMANDS)

# Reads its file only when another has been read: a pipe of the test.
WAITING = """
import sys
from libmodbus_py.cli.main import main
from libmodbus_py.tools.files import texts

def read_later(*arguments):
    if waits:
        waits.clear()
        print("starting", flush=True)
        open("go").close()
    return read(*arguments)

waits = ["go"]
read, texts.read_text = texts.read_text, read_later
sys.exit(main())
"""


class Waiting(Started):
    """A command that is about to read its file."""

    program = ("-c", WAITING)

    def __init__(self, folder: Path, name: str) -> None:
        self._go = folder / "go"
        os.mkfifo(self._go)
        super().__init__(folder, name)

    def go_on(self) -> None:
        """Let it read the file, unless the signal has ended it."""
        until(lambda: self.process.poll() is not None or self._is_let())

    def _is_let(self) -> bool:
        with contextlib.suppress(OSError):
            os.close(os.open(self._go, os.O_WRONLY | os.O_NONBLOCK))
            return True
        return False


@contextlib.contextmanager
def waiting(folder: Path, name: str) -> Iterator[Waiting]:
    with contextlib.closing(Waiting(folder, name)) as made:
        until(lambda: "starting" in made.said)
        yield made


@NAMES
def test_what_it_reads_is_read_again(tmp_path: Path, name: str) -> None:
    with waiting(tmp_path, name) as command:
        command.process.send_signal(signal.SIGHUP)
        command.go_on()
        until(lambda: COMMANDS[name][1] in command.said or command.process.poll() is not None)
        assert command.process.poll() is None
        command.process.terminate()
        assert command.process.wait(20) == 0


@NAMES
def test_a_terminal_that_closes_while_a_command_starts_ends_it(tmp_path: Path, name: str) -> None:
    with waiting(tmp_path, name) as command:
        os.close(command.master)
        command.go_on()
        assert command.process.wait(20) == 0
        assert "Traceback" not in command.said


@pytest.mark.parametrize(
    "arguments", [["serve"], ["gateway", "--to", "tcp://127.0.0.1:1"]], ids=lambda each: each[0]
)
def test_without_a_file_it_says_so_and_goes_on(arguments: list[str]) -> None:
    with Forked(*arguments, "tcp://127.0.0.1:0") as process:
        assert "listening on" in process.stdout.readline()
        process.send_signal(signal.SIGHUP)
        assert process.stderr.readline().startswith("there are no files")
        process.terminate()
        assert process.wait() == 0
