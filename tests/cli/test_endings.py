"""How commands end: by a signal, by a pipe that is closed, and by an error that nobody expected."""

import re
import signal
import subprocess
import termios
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.tools.testing.recording import ServerMaker
from libmodbus_py.tools.testing.wires import SerialWire
from tests.cli.serving import FLEET_OF_ONE
from tests.support.cases import each_case
from tests.support.commands import PROGRAM, Started, on_terminal, run
from tests.support.peers import FakeServer, mbap, until
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
def test_a_signal_ends_a_command(tmp_path: Path, device: str, name: str, number: int, code: int):
    (tmp_path / "fleet.toml").write_text(FLEET.format(url=device))
    arguments = [command.format(url=device, folder=tmp_path) for command in COMMANDS[name][0]]
    with subprocess.Popen(
        [*PROGRAM, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            stream = process.stderr if name == "listen" else process.stdout
            assert stream is not None
            assert stream.readline()
            process.send_signal(number)
            _, errors = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == code
    assert "Traceback" not in errors


@pytest.mark.parametrize("name", ["poll", "read"])
def test_a_closed_pipe_ends_the_command(tmp_path: Path, device: str, name: str) -> None:
    (tmp_path / "fleet.toml").write_text(FLEET.format(url=device))
    arguments = [command.format(url=device, folder=tmp_path) for command in COMMANDS[name][0]]
    program = " ".join(f"'{word}'" for word in [*PROGRAM, *arguments])
    result = run_to_end("bash", "-o", "pipefail", "-c", f"{program} | head -1")
    assert result.stdout.count("\n") == 1
    assert (result.returncode, result.stderr) == (1, "")


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
    ("words", "count"),
    [
        ("read URL hr 0 --json", 0),
        ("write URL hr 0 5 --verify", 0),
        ("write URL hr 0 5 --verify", 1),
        ("identify URL", 0),
        ("raw URL 3 00000001", 0),
        ("map check meter --device URL", 0),
    ],
)
def test_ctrl_c_while_waiting_for_an_answer_ends_the_command(words: str, count: int) -> None:
    """Nothing is said, whether it is the first answer, or that behind a write."""
    requests: list[bytes] = []

    def answer(request: bytes) -> list[bytes]:
        requests.append(request)
        return [request] if len(requests) <= count else []

    with FakeServer(answer) as server:
        typed = words.replace("URL", server.url).split()
        with Started(*typed, "--timeout", "20") as process:
            until(lambda: len(requests) > count)
            process.send_signal(signal.SIGINT)
            out, err = process.communicate()
            assert (process.wait(), err) == (130, "")
            assert "meter" in out if typed[0] == "map" else out == ""


@each_case("code", [10, 11])
def test_an_absent_unit_behind_a_gateway_points_to_scan(code: int) -> None:
    with FakeServer(lambda request: [mbap(request, bytes([request[7] | 0x80, code]))]) as server:
        place = f"127.0.0.1:{server.port}"
        for words in (["read", place, "hr", 0], ["write", place, "hr", 0, 1], ["raw", place, 7]):
            result = run(*words)
            assert result.code == 1
            assert result.err.endswith(f"; libmodbus-py scan {place} finds the units that answer\n")
            assert result.err.count("\n") == 1


@each_case("words", [["hr", 0], ["hr", 0, "co", 1], ["-u", "3,4", "hr", 0]])
def test_silence_points_to_scan(words: list[object]) -> None:
    with FakeServer(lambda _: []) as server:
        place = f"127.0.0.1:{server.port}"
        result = run("read", place, *words, "--timeout", "20ms")
        assert result.code == 1
        for line in result.err.splitlines():
            assert line.endswith(f"no answer within 0.02 s; libmodbus-py scan {place} finds the"
                                 " units that answer")  # fmt: skip


def test_other_failures_do_not_point_to_scan() -> None:
    with ServerMaker() as maker:
        url = maker(devices=Device(Mapping(holding_registers=2))).url
        for words in (["read", url, "hr", 7], ["write", url, "hr", 7, 1]):
            assert "scan" not in run(*words).err
    assert "scan" not in run("read", "127.0.0.1:1", "hr", 0).err


def test_tls_at_a_server_without_it_is_one_line(tmp_path: Path) -> None:
    assert run("certificates", tmp_path).code == 0
    pki = ["--cert", tmp_path / "operator.pem", "--key", tmp_path / "operator-key.pem"]
    with FakeServer(None) as server:
        url = f"tls://127.0.0.1:{server.port}"
        result = run("read", url, "hr", 0, *pki, "--ca", tmp_path / "ca.pem")
        assert result.code == 1
        assert "no TLS handshake" in result.err
        assert "is it tcp://?" in result.err


def shown_on_terminal(*words: str, **environment: str) -> str:
    with on_terminal(*words, environment={"NO_COLOR": "", **environment}) as terminal:
        return terminal.read_to_end().replace("\r\n", "\n")


def without_styles(text: str) -> str:
    return re.sub(r"\x1b\[[0-9;]*m", "", text)


@each_case(
    "words",
    [
        ("read", "192.0.2.10", "nonsense"),  # found by the command
        ("read", "--nonsense"),  # by argparse
        ("nonsense",),
        ("read", "127.0.0.1:1", "hr", "0"),  # by the system
    ],
)
def test_an_error_begins_with_red(words: tuple[str, ...]) -> None:
    text = shown_on_terminal(*words)
    assert text.startswith("\x1b[1;31mlibmodbus-py:\x1b[0m ")
    assert without_styles(text) == run(*words).err


@each_case("environment", [{"NO_COLOR": "1"}, {"TERM": "dumb"}])
def test_colours_are_left_out_where_they_are_not_wanted(environment: dict[str, str]) -> None:
    assert "\x1b" not in shown_on_terminal("read", "--nonsense", **environment)


def test_colour_of_errors_follows_stderr() -> None:
    assert "\x1b" not in run("read", "--nonsense").err
