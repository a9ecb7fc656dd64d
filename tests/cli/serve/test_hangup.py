"""
SIGHUP of commands that serve. A terminal that closes ends what was started in it, also while that
starts; SIGHUP from others has files read again, those too that were read while it came.
"""

import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Client, Device, Mapping, Server
from tests.cli.serving import INFO, reload_line, serving
from tests.support.commands import Started as Forked
from tests.support.peers import until

FILES = {
    "serve": "[[unit]]\nid = 1\n[[unit.holding_registers]]\naddress = 0\nvalue = 1\n",
    "gateway": 'listen = ["tcp://127.0.0.1:0"]\n[[route]]\nurl = "tcp://127.0.0.1:1"\n',
    "poll": '[[device]]\nname = "a"\nurl = "tcp://127.0.0.1:1"\nmap = "map.csv"\n',
}

COMMANDS = {
    "serve": ["tcp://127.0.0.1:0", "--device", "file", *INFO],
    "gateway": ["--config", "file", *INFO],
    "poll": ["file", *INFO],
}

NO_FILE = "not a regular file"

SAID = "file: read again, 1 "

# Has its standard input for a terminal, as what is started in one has.
BEGIN = (
    "import fcntl, os, signal, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); "
    "signal.signal(signal.SIGHUP, signal.SIG_IGN if sys.argv[1] == 'nohup' else signal.SIG_DFL); "
    "how = ['-c', os.environ['GATED']] if sys.argv[1] == 'waiting' else ['-m', 'libmodbus_py']; "
    "os.execv(sys.executable, [sys.executable, *how, *sys.argv[2:]])"
)

# The first file that is opened is as one on a slow disk: until the pipe "gate" is closed.
GATED = """
import os, runpy, sys
from libmodbus_py.files import texts
open_file = texts.open_file
def open_slowly(path):
    texts.open_file = open_file
    open("gate").read()
    return open_file(path)
texts.open_file = open_slowly
runpy.run_module("libmodbus_py", run_name="__main__")
"""

NAMES = pytest.mark.parametrize("name", COMMANDS)


class Started:
    """A command in a terminal of its own, whose other end is `master`."""

    def __init__(self, folder: Path, name: str, how: str) -> None:
        self._log = folder / "log"
        self.master, slave = pty.openpty()
        with open(self._log, "wb") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-c", BEGIN, how, name, *COMMANDS[name]],
                cwd=folder,
                stdin=slave,
                stdout=log,
                stderr=log,
                start_new_session=True,
                env={**os.environ, "PYTHONUNBUFFERED": "1", "GATED": GATED},
            )
        os.close(slave)

    @property
    def said(self) -> str:
        return self._log.read_text()

    def hang_up(self) -> None:
        """Send SIGHUP, and wait until the file was read again."""
        before = self.said.count(SAID)
        self.process.send_signal(signal.SIGHUP)
        until(lambda: self.said.count(SAID) > before)

    def end(self) -> None:
        assert self.process.poll() is None
        self.process.terminate()
        assert self.process.wait(20) == 0


@contextlib.contextmanager
def start(folder: Path, name: str, how: str = "") -> Iterator[Started]:
    (folder / "map.csv").write_text("name,table,address\nx,holding_registers,0\n")
    if how == "waiting":
        os.mkfifo(folder / "gate")
    else:
        (folder / "file").write_text(FILES[name])
    process = Started(folder, name, how)
    try:
        if how != "waiting":
            until(lambda: catches_hangup(process.process.pid))
        yield process
    finally:
        process.process.kill()
        process.process.wait()
        with contextlib.suppress(OSError):
            os.close(process.master)


def catches_hangup(process: int) -> bool:
    text = Path(f"/proc/{process}/status").read_text()
    return bool(int(text.partition("SigCgt:")[2].split()[0], 16) & 1)


@contextlib.contextmanager
def being_read(folder: Path, text: str) -> Iterator[None]:
    """Let a program wait for the file that it has begun to read, until the block ends."""
    (folder / "file").write_text(text)
    with open(folder / "gate", "w"):
        yield


@NAMES
def test_a_closed_terminal_ends_the_command(tmp_path: Path, name: str) -> None:
    with start(tmp_path, name) as command:
        command.hang_up()
        os.close(command.master)
        assert command.process.wait(20) == 0
        assert "Traceback" not in command.said


@NAMES
def test_under_nohup_a_hangup_ends_no_command(tmp_path: Path, name: str) -> None:
    with start(tmp_path, name, "nohup") as command:
        os.close(command.master)
        command.hang_up()
        command.hang_up()
        command.end()


@NAMES
def test_a_hangup_while_files_are_read_reads_them_again(tmp_path: Path, name: str) -> None:
    with start(tmp_path, name, "waiting") as command:
        with being_read(tmp_path, FILES[name]):
            command.process.send_signal(signal.SIGHUP)
        until(lambda: SAID in command.said or command.process.poll() is not None)
        command.end()


@NAMES
def test_a_terminal_closed_during_the_start_ends_the_command(tmp_path: Path, name: str) -> None:
    with start(tmp_path, name, "waiting") as command:
        with being_read(tmp_path, FILES[name]):
            os.close(command.master)
        assert command.process.wait(20) == 0
        assert "Traceback" not in command.said


@NAMES
def test_a_command_that_cannot_start_names_the_reason(tmp_path: Path, name: str) -> None:
    with start(tmp_path, name, "waiting") as command:
        with being_read(tmp_path, "x = 1"):
            command.process.send_signal(signal.SIGHUP)
        assert command.process.wait(20) == 2
        assert "file, line 1: " in command.said


def test_a_reload_without_a_file_is_reported_and_the_server_continues(command: list[str]) -> None:
    with Forked(*command, "tcp://127.0.0.1:0", *INFO) as process:
        assert "listening on" in process.stdout.readline()
        process.send_signal(signal.SIGHUP)
        assert reload_line(process).startswith("there are no files")
        process.terminate()
        assert process.wait() == 0


def test_a_gateway_ends_with_the_newest_routes(tmp_path: Path) -> None:
    path = tmp_path / "gateway.toml"
    with Server(Device(Mapping(10))).background("tcp://127.0.0.1:0") as running:

        def write(units: str) -> None:
            route = f"[[route]]\nurl = '{running.urls[0]}'\nunits = '{units}'\n"
            path.write_text(f"listen = ['tcp://127.0.0.1:0']\n{route}")

        write("1")
        with serving("gateway", "--config", path, *INFO) as (process, url):
            with Client(url, unit=1, timeout=5) as context:
                for unit in range(2, 20):
                    write(f"1,{unit}")
                    for _ in range(2):  # the second perhaps before the first was answered
                        process.send_signal(signal.SIGHUP)
                    assert context.read_coils(0, 1) == [False]
                prefix = f"{path}: read again, 1 route: "
                assert reload_line(process) == f"{prefix}1 new, 1 removed"
                assert reload_line(process).startswith(prefix)
                write("1-300")
                process.send_signal(signal.SIGHUP)
                while not (line := reload_line(process)).startswith("the former"):
                    assert line.startswith(prefix)
                assert line.endswith(
                    f"{path}, line 4: route[0].units: '1-300' must go up, within 0..255"
                )
                assert context.for_unit(19).read_coils(0, 1) == [False]
                assert context.statistics.connects == 1
            process.send_signal(signal.SIGHUP)


def test_poll_reads_the_file_again(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    with Server(Device(Mapping(10, 10, 10, 10))).background("tcp://127.0.0.1:0") as running:
        text = FILES["poll"].replace("tcp://127.0.0.1:1", running.urls[0]) + "interval = 0.02\n"
        (tmp_path / "map.csv").write_text("name,table,address\nx,holding_registers,0\n")
        path.write_text(text)
        with Forked("poll", path, *INFO) as process:

            def reading() -> dict[str, str]:
                row: dict[str, str] = json.loads(process.stdout.readline())
                return row

            def said_of(content: str) -> str:
                path.write_text(content)
                process.send_signal(signal.SIGHUP)
                return reload_line(process)

            assert reading()["device"] == "a"
            assert said_of("nothing").startswith("the former content is used: ")
            assert said_of(f"{text}[output.csv]\npath = 'readings.csv'\n") == (
                f"{path}: read again, 1 device: no change;"
                " its outputs have changed, and are used after a restart"
            )
            assert not (tmp_path / "readings.csv").exists()
            (tmp_path / "fleet.toml").write_text(text.replace('"a"', '"b"'))
            process.send_signal(signal.SIGHUP)
            prefix = f"{path}: read again, 1 device: "
            assert reload_line(process) == f"{prefix}1 new, 1 removed"
            while reading()["device"] != "b":
                pass
            for make in (os.mkfifo, lambda path: path.symlink_to("/dev/zero")):
                path.unlink()
                make(path)
                process.send_signal(signal.SIGHUP)
                line = reload_line(process)
                assert line == f"the former content is used: cannot read {path}: {NO_FILE}"
                assert reading()["device"] == "b"
            process.terminate()
            process.communicate()
            assert process.returncode == 0
