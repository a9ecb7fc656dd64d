"""
How commands that run for long end: each is started as people start it.

The other tests of these commands fork them, see `tests.support.commands`. What happens to them when
a terminal closes, and SIGHUP, is in `test_hangup.py`.
"""

import signal
import subprocess
import termios
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.tools.testing.wires import SerialWire
from tests.cli.serving import FLEET_OF_ONE
from tests.support.commands import PROGRAM, Started
from tests.support.peers import FakeServer, until
from tests.support.programs import run_to_end

FLEET = f"[defaults]\ninterval = 0.05\n{FLEET_OF_ONE}"

# What is typed, and which exit codes SIGINT and SIGTERM bring.
COMMANDS = {
    "serve": (["serve", "tcp://127.0.0.1:0"], 0, 0),
    "gateway": (["gateway", "tcp://127.0.0.1:0", "--to", "{url}"], 0, 0),
    "poll": (["poll", "{folder}/fleet.toml"], 0, 0),
    "listen": (["listen", "rtu+tcp://127.0.0.1:0", "--between", "rtu+tcp://127.0.0.1:1"], 0, 0),
    "read": (["read", "{url}", "holding", "0", "--watch", "0.05"], 130, -signal.SIGTERM),
}

CASES = [
    (name, number, code)
    for name, (_, interrupted, terminated) in COMMANDS.items()
    for number, code in ((signal.SIGINT, interrupted), (signal.SIGTERM, terminated))
]


@pytest.mark.parametrize(("name", "number", "code"), CASES)
def test_a_signal_ends_it(tmp_path: Path, device: str, name: str, number: int, code: int) -> None:
    (tmp_path / "fleet.toml").write_text(FLEET.format(url=device))
    arguments = [each.format(url=device, folder=tmp_path) for each in COMMANDS[name][0]]
    with subprocess.Popen(
        [*PROGRAM, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            begun = process.stderr if name == "listen" else process.stdout
            assert begun is not None
            assert begun.readline()
            process.send_signal(number)
            _, errors = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == code
    assert "Traceback" not in errors


@pytest.mark.parametrize("name", ["poll", "read"])
def test_a_reader_that_goes_away_ends_it(tmp_path: Path, device: str, name: str) -> None:
    (tmp_path / "fleet.toml").write_text(FLEET.format(url=device))
    arguments = [each.format(url=device, folder=tmp_path) for each in COMMANDS[name][0]]
    program = " ".join(f"'{word}'" for word in [*PROGRAM, *arguments])
    done = run_to_end("bash", "-o", "pipefail", "-c", f"{program} | head -1")
    assert done.stdout.count("\n") == 1
    assert (done.returncode, done.stderr) == (1, "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_serial_port_gets_its_settings_back(number: int) -> None:
    device = Device(Mapping(holding_registers=10))
    with SerialWire() as wire, open(wire.client, "rb", buffering=0) as port:
        before = termios.tcgetattr(port)
        with (
            Server(device).background(f"rtu://{wire.server}?baudrate=9600"),
            Started(
                "read", wire.client, "-b", "9600", "holding", "0", "--watch", "0.01"
            ) as process,
        ):
            process.stdout.readline()
            assert termios.tcgetattr(port) != before
            process.send_signal(number)
            process.communicate()
        assert termios.tcgetattr(port) == before


@pytest.mark.parametrize(
    ("words", "answered"),
    [
        ("read URL hr 0 --json", 0),
        ("write URL hr 0 5 --verify", 0),
        ("write URL hr 0 5 --verify", 1),
        ("identify URL", 0),
        ("raw URL 3 00000001", 0),
        ("map check meter --device URL", 0),
    ],
)
def test_ctrl_c_while_an_answer_is_awaited(words: str, answered: int) -> None:
    """Nothing is said, whether it is the first answer, or that behind a write."""
    asked: list[bytes] = []

    def answer(request: bytes) -> list[bytes]:
        asked.append(request)
        return [request] if len(asked) <= answered else []

    with FakeServer(answer) as server:
        typed = words.replace("URL", server.url).split()
        with Started(*typed, "--timeout", "20") as process:
            until(lambda: len(asked) > answered)
            process.send_signal(signal.SIGINT)
            out, err = process.communicate()
            assert (process.wait(), err) == (130, "")
            assert "meter" in out if typed[0] == "map" else out == ""
