"""
SIGHUP while a command starts: what it reads is read again as soon as it has started, or it ends if
its terminal was closed.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from fuzz.asked_devices import until
from tests.cli.serve.test_hangup import COMMANDS, Started

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
def test_a_terminal_that_closes_ends_it(tmp_path: Path, name: str) -> None:
    with waiting(tmp_path, name) as command:
        os.close(command.master)
        command.go_on()
        assert command.process.wait(20) == 0
        assert "Traceback" not in command.said


@pytest.mark.parametrize(
    "arguments", [["serve"], ["gateway", "--to", "tcp://127.0.0.1:1"]], ids=lambda each: each[0]
)
def test_without_a_file_it_ends_as_ever(arguments: list[str]) -> None:
    """Where there is nothing to read again, the signal has the effect that the system gives it."""
    command = [sys.executable, "-m", "libmodbus_py", *arguments, "tcp://127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert "listening on" in process.stdout.readline()
        process.send_signal(signal.SIGHUP)
        assert process.wait(20) == -signal.SIGHUP
