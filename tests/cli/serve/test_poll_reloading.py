"""
SIGHUP at any time of the command poll: while it starts, while it polls, while it reads its file.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.protocol.plain import time_text

# The command, which waits for a line before it reads its file.
PROGRAM = """
import sys
from libmodbus_py.cli.main import main
from libmodbus_py.cli.serve import poll

load = poll.load

def waiting(path):
    print("reading", file=sys.stderr, flush=True)
    sys.stdin.readline()
    return load(path)

poll.load = waiting
sys.exit(main(["poll", sys.argv[1]]))
"""

METER = "name,table,address\nlevel,holding_registers,0\n"


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Path]:
    (tmp_path / "meter.csv").write_text(METER)
    with Server(Device(Mapping(holding_registers=10))).background("tcp://127.0.0.1:0") as running:
        (tmp_path / "fleet.toml").write_text(
            "[defaults]\nmap = 'meter.csv'\ninterval = 0.02\n"
            f"[[device]]\nname = 'one'\nurl = '{running.urls[0]}'\n"
        )
        yield tmp_path / "fleet.toml"


class Started:
    """The command, with texts in place of bytes."""

    def __init__(self, fleet: Path) -> None:
        self.fleet = fleet
        self.process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, str(fleet)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def hang_up(self) -> None:
        self.process.send_signal(signal.SIGHUP)

    def said(self) -> str:
        assert self.process.stderr is not None
        return self.process.stderr.readline().removesuffix("\n")

    def reading(self) -> dict[str, str]:
        assert self.process.stdout is not None
        told: dict[str, str] = json.loads(self.process.stdout.readline())
        return told

    def polled(self) -> str:
        return self.reading()["device"]

    def read(self) -> None:
        """Let it read its file, which it has begun to."""
        assert self.said() == "reading"
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()


@pytest.fixture
def command(fleet: Path) -> Iterator[Started]:
    started = Started(fleet)
    with started.process:
        yield started
        started.process.terminate()
        assert started.process.wait(30) == 0


def test_it_may_come_while_the_command_starts(command: Started) -> None:
    assert command.said() == "reading"
    command.hang_up()
    command.hang_up()
    assert command.process.stdin is not None
    command.process.stdin.write("\n")
    command.process.stdin.flush()
    command.read()
    assert command.said() == f"{command.fleet}: read again, 1 device: no change"
    assert command.polled() == "one"


def test_devices_are_polled_while_the_file_is_read(command: Started) -> None:
    command.read()
    command.polled()
    text = command.fleet.read_text()
    command.fleet.write_text(text.replace("'one'", "'two'"))
    command.hang_up()
    assert command.said() == "reading"
    now = time.time()
    while command.reading()["time"] < time_text(now + 0.1):
        pass
    # It is read once more, because it may have changed meanwhile.
    command.hang_up()
    assert command.process.stdin is not None
    command.process.stdin.write("\n")
    command.process.stdin.flush()
    assert command.said() == f"{command.fleet}: read again, 1 device: 1 new, 1 removed"
    command.read()
    assert command.said() == f"{command.fleet}: read again, 1 device: no change"
    while command.polled() != "two":
        pass


def test_it_ends_though_the_file_cannot_be_read_to_its_end(command: Started) -> None:
    command.read()
    command.polled()
    command.hang_up()
    assert command.said() == "reading"


def test_outputs_that_have_changed_are_told(command: Started) -> None:
    command.read()
    command.polled()
    text = command.fleet.read_text()
    command.fleet.write_text(f"{text}[output.csv]\npath = 'readings.csv'\n")
    for _ in range(2):
        command.hang_up()
        command.read()
        assert command.said() == (
            f"{command.fleet}: read again, 1 device: no change;"
            " its outputs have changed, and are used after a restart"
        )
    command.fleet.write_text(text)
    command.hang_up()
    command.read()
    assert command.said() == f"{command.fleet}: read again, 1 device: no change"
    assert not (command.fleet.parent / "readings.csv").exists()
