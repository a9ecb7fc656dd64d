"""
The command line: what it prints, and its exit codes, as a process of its own.
"""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.tap import SerialWire

COMMAND = [sys.executable, "-m", "libmodbus_py"]


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, timeout=30)


@contextmanager
def serving(*urls: str) -> Iterator[list[str]]:
    process = subprocess.Popen([*COMMAND, "serve", *urls], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in urls]
        yield [line.removeprefix("listening on ").rstrip("\n") for line in lines]
        process.send_signal(signal.SIGTERM)
        assert process.wait(1) == 0
    finally:
        process.kill()
        process.communicate()


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    with serving("tcp://127.0.0.1:0") as urls:
        yield urls[0]


def test_demo_shows_every_example_on_every_line() -> None:
    done = run("demo")
    assert done.returncode == 0
    assert done.stderr == ""
    assert "\x1b" not in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 80
    for line in (
        "00 01 00 00 00 06 06 03 00 7A 00 03",
        "06 03 06 03 15 30 39 FD C9 55 7E",
        r":0603007A00037A\r\n",
        r":11140C05060DFE0020050633CD00404E\r\n",
        r":0D86026B\r\n",
    ):
        assert line in done.stdout
    assert done.stdout.count("789  12345  -567") == 3
    assert done.stdout.count("0DFE 0020   33CD 0040") == 3
    assert done.stdout.count("refused: illegal data address (exception 2)") == 3


def test_demo_has_colour_on_a_terminal_only() -> None:
    for environment, colour in (({}, True), ({"NO_COLOR": "1"}, False)):
        master, slave = pty.openpty()
        process = subprocess.Popen(
            [*COMMAND, "demo"], stdout=slave, env=os.environ | environment, close_fds=True
        )
        os.close(slave)
        output = b""
        while True:
            try:
                output += os.read(master, 4096)
            except OSError:
                break
        os.close(master)
        assert process.wait() == 0
        assert (b"\x1b[32m" in output) == colour


def test_serve_has_all_tables_and_files_for_every_unit(url: str) -> None:
    for unit, *where in (
        ("1", "coils", "0", "2000"),
        ("247", "discrete", "65535"),
        ("0", "holding", "65411", "125"),
        ("255", "input", "65535", "1"),
        ("9", "file:1", "0"),
        ("9", "file:10", "9900", "100"),
    ):
        done = run("read", url, *where, "--unit", unit, "--json")
        assert done.returncode == 0, done.stderr
        assert set(json.loads(done.stdout)["values"]) == {0}


@pytest.mark.parametrize(
    ("where", "values", "printed"),
    [
        (
            ["holding", "100"],
            ["789", "12345", "-567"],
            "  100    789\n  101  12345\n  102  64969\n",
        ),
        (["40201"], ["0xFFFF"], "  200  65535\n"),
        (["coils", "7"], ["on"], "    7  1\n"),
        (["coils", "10"], ["1", "off", "true"], "   10  1\n   11  0\n   12  1\n"),
        (["file:4", "9998"], ["1", "2"], " 9998  1\n 9999  2\n"),
    ],
)
def test_what_is_written_is_read(
    url: str, where: list[str], values: list[str], printed: str
) -> None:
    written = run("write", url, *where, *values)
    assert (written.returncode, written.stdout, written.stderr) == (0, "", "")
    assert run("read", url, *where, str(len(values))).stdout == printed


def test_json_says_what_was_read(url: str) -> None:
    assert json.loads(run("read", url, "400401", "2", "--json").stdout) == {
        "unit": 1,
        "table": "holding_registers",
        "address": 400,
        "values": [0, 0],
    }


@pytest.mark.parametrize("kind", ["rtu", "ascii"])
def test_serial_ports_are_served_and_read(kind: str) -> None:
    with SerialWire() as wire, serving(f"{kind}://{wire.server}?baudrate=115200"):
        client = f"{kind}://{wire.client}?baudrate=115200"
        assert run("write", client, "holding", "5", "42").returncode == 0
        assert run("read", client, "holding", "5").stdout == "    5  42\n"


def test_refusal_is_one_line_and_exit_code_1() -> None:
    device = Device(Mapping(holding_registers=10))
    with Server(device).background("tcp://127.0.0.1:0") as running:
        done = run("read", running.urls[0], "holding", "10")
    assert done.returncode == 1
    assert done.stdout == ""
    assert re.fullmatch(
        r"libmodbus-py: unit 1, function 3, .*illegal data address \(exception 2\)\n", done.stderr
    )


@pytest.mark.parametrize(
    ("arguments", "code", "named"),
    [
        (["read", "tcp://127.0.0.1:1", "coils", "0"], 1, "refused"),
        (["read", "tcp://no-such-host.invalid", "coils", "0"], 1, "no-such-host"),
        (["read", "rtu:///dev/no-such-port", "coils", "0"], 1, "/dev/no-such-port"),
        (["serve", "rtu:///dev/null"], 1, "not a serial port"),
        (["serve", "tcp://127.0.0.1:99999"], 2, "port"),
        (["serve"], 2, "URL"),
        ([], 2, "COMMAND"),
        (["read", "udp://127.0.0.1", "coils", "0"], 2, "scheme"),
        (["read", "tcp://127.0.0.1:1", "colis", "0"], 2, "colis"),
        (["read", "tcp://127.0.0.1:1", "coils"], 2, "address"),
        (["read", "tcp://127.0.0.1:1", "coils", "x"], 2, "address"),
        (["read", "tcp://127.0.0.1:1", "coils", "65536"], 2, "address must be in 0..65535"),
        (["read", "tcp://127.0.0.1:1", "coils", "0", "2001"], 2, "count must be in 1..2000"),
        (["read", "tcp://127.0.0.1:1", "coils", "0", "1", "2"], 2, "'2'"),
        (["read", "tcp://127.0.0.1:1", "file", "0"], 2, "file:4"),
        (["read", "tcp://127.0.0.1:1", "file:0", "0"], 2, "file must be in 1..65535"),
        (["read", "tcp://127.0.0.1:1", "coils:1", "0"], 2, "only a file"),
        (["read", "tcp://127.0.0.1:1", "50001"], 2, "50001"),
        (["read", "tcp://127.0.0.1:1", "600007"], 2, "file:N"),
        (["read", "tcp://127.0.0.1:1", "coils", "0", "--unit", "256"], 2, "unit"),
        (["read", "tcp://127.0.0.1:1", "coils", "0", "--timeout", "-1"], 2, "timeout"),
        (["write", "tcp://127.0.0.1:1", "coils", "0"], 2, "no value"),
        (["write", "tcp://127.0.0.1:1", "coils", "0", "2"], 2, "'2'"),
        (["write", "tcp://127.0.0.1:1", "holding", "0", "65536"], 2, "-32768..65535"),
        (["write", "tcp://127.0.0.1:1", "input", "0", "1"], 2, "can only be read"),
        (["write", "tcp://127.0.0.1:1", "10001", "1"], 2, "can only be read"),
    ],
)
def test_errors_are_one_line_on_stderr(arguments: list[str], code: int, named: str) -> None:
    done = run(*arguments)
    assert done.returncode == code
    assert done.stdout == ""
    assert done.stderr.startswith("libmodbus-py: ")
    assert done.stderr.count("\n") == 1
    assert named in done.stderr


def test_serve_says_when_a_port_is_taken(url: str) -> None:
    done = run("serve", url)
    assert done.returncode == 1
    assert done.stderr == f"libmodbus-py: cannot listen on {url}: Address already in use\n"


def test_serve_stops_on_ctrl_c() -> None:
    process = subprocess.Popen(
        [*COMMAND, "serve", "tcp://127.0.0.1:0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=1) == ("", "")
    assert process.returncode == 0
