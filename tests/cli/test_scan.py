"""
The command scan: what it prints, where, and its exit codes, as a process of its own.
"""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, Server, device_file
from libmodbus_py.testing.wires import SerialWire
from tests.support.fake import FakeServer, mbap, refusing, until, url_of

COMMAND = [sys.executable, "-m", "libmodbus_py", "scan"]


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, timeout=50)


@pytest.fixture
def url() -> Iterator[str]:
    devices = {
        3: Device(
            Mapping(holding_registers=[range(4), range(6, 8)], coils=1),
            identification={"VendorName": "ACME", "ProductCode": "\x1b[31m", 2: "1"},
        ),
        7: Device(Mapping()),
    }
    with Server(devices).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


def test_who_answers_is_printed_and_the_rest_goes_elsewhere(url: str) -> None:
    done = run(url)
    assert done.returncode == 0
    first, second = done.stdout.splitlines()
    assert first.startswith("unit 3: ")
    assert "ACME" in first
    assert second.startswith("unit 7: ")
    assert ", exception 2" in second
    assert "\x1b" not in done.stdout + done.stderr  # whatever a device says
    estimate, note = done.stderr.splitlines()
    assert "248 probes" in estimate
    assert "4 min 12 s at most" in estimate
    assert "a gateway says of 246 units" in note


def test_json_is_one_line(url: str) -> None:
    done = run(url, "--units", "1,3-4", "--json", "--deep")
    (line,) = done.stdout.splitlines()
    told = json.loads(line)
    assert told["stopped"] is False
    assert len(told["notes"]) == 1
    (found,) = told["found"]
    assert (found["unit"], found["exception"], found["baudrate"]) == (3, None, None)
    assert found["identification"]["VendorName"] == "ACME"
    assert found["tables"]["holding_registers"]["ranges"] == [
        {"address": 0, "count": 4},
        {"address": 6, "count": 2},
    ]
    assert sum(each["requests"] for each in found["tables"].values()) <= 2000


def test_what_deep_prints_is_a_device_file(url: str, tmp_path: Path) -> None:
    done = run(url, "--units", "3,7", "--deep")
    assert done.returncode == 0
    assert "up to 2000 requests to each unit found" in done.stderr
    text = "\n".join(line for line in done.stdout.splitlines() if not line.startswith("unit "))
    assert [unit["id"] for unit in tomllib.loads(text)["unit"]] == [3, 7]
    assert "# coils: ended by the bound on requests, ranges of up to" in text
    path = tmp_path / "found.toml"
    path.write_text(text)
    devices, _ = device_file.load(path)
    assert devices[3].mapping.holding_registers[6:8] == [0, 0]


def test_nobody_is_exit_code_1(url: str) -> None:
    done = run(url, "--units", "200")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.splitlines()[-1] == "nobody was found"
    done = run(url, "--units", "200", "--json")
    assert done.returncode == 1
    assert json.loads(done.stdout)["found"] == []


def test_no_connection_is_one_line_and_exit_code_1() -> None:
    with refusing() as bound:
        done = run(url_of(bound))
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert done.stderr.splitlines()[-1].startswith("libmodbus-py: ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--units", "0-300"], "'0-300' must go up, within 0..255"),
        (["--units", "9-5"], "'9-5' must go up, within 0..255"),
        (["--units", "1,,3"], "'' must be a unit, or two such as 1-247"),
        (["--units", "-3"], "'-3' must be a unit"),
        (["--units", "x"], "'x' must be a unit"),
        (["--units", "٣"], "must be a unit"),
        (["--baudrates", "96OO"], "'96OO' must be bits per second"),
        (["--baudrates", "9600,,"], "'' must be bits per second"),
        (["--baudrates", "9600"], "baudrates are for serial ports"),
        (["--parities", "E,X"], "'X' must be one of E, N, O"),
        (["--timeout", "0"], "timeout must be in 0.001..86400 seconds"),
    ],
)
def test_what_is_typed_wrong_is_one_line_and_nothing_is_sent(
    arguments: list[str], message: str
) -> None:
    with FakeServer(lambda request: []) as server:
        done = run(server.url, *(f"{arguments[0]}={each}" for each in arguments[1:]))
        assert server.connections == 0
    assert (done.returncode, done.stdout) == (2, "")
    assert message in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("as_json", [False, True])
def test_ctrl_c_prints_what_was_found_and_restores_the_line(as_json: bool) -> None:
    with SerialWire() as wire:
        server = Server({1: Device(Mapping())})
        before = _settings(wire.client)
        with server.background(f"rtu://{wire.server}?baudrate=19200"):
            process = subprocess.Popen(
                [*COMMAND, f"rtu://{wire.client}", "--baudrates", "19200", *["--json"] * as_json],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            try:
                # The unit behind those that answered, reserved ones and identification included.
                until(lambda: wire.sent_by("client").count(b"\x02\x03\0\0\0\1") == 1)
                process.send_signal(signal.SIGINT)
                output, errors = process.communicate(timeout=20)
            finally:
                process.kill()
                process.wait()
        assert process.returncode == 130
        assert "Traceback" not in errors
        if as_json:
            told = json.loads(output)
            assert told["stopped"] is True
            assert [each["unit"] for each in told["found"]] == [1]
        else:
            assert output.startswith("unit 1 at 19200 8E1: ")
        assert _settings(wire.client) == before


def test_ctrl_c_in_a_search_prints_what_was_found() -> None:
    def answer(request: bytes) -> list[bytes]:
        count = int.from_bytes(request[10:12], "big")
        if request[6] != 1 or request[7] > 4:
            return [mbap(request, bytes([request[7] | 0x80, 11]))]
        size = (count + 7) // 8 if request[7] < 3 else 2 * count
        time.sleep(0.01)
        return [mbap(request, bytes([request[7], size]) + bytes(size))]

    with FakeServer(answer) as server:
        process = subprocess.Popen(
            [*COMMAND, server.url, "--units", "1", "--deep"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            until(lambda: len(server.requests) > 60)
            process.send_signal(signal.SIGINT)
            output, errors = process.communicate(timeout=20)
        finally:
            process.kill()
            process.wait()
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert "[[unit.coils]]\naddress = 0\ncount = 65536\n" in output
    assert "# discrete_inputs: ended by whoever searched" in output


def _settings(path: str) -> str:
    done = subprocess.run(["stty", "-g", "-F", path], capture_output=True, text=True, check=True)
    return done.stdout


def test_a_terminal_has_progress() -> None:
    def answer(request: bytes) -> list[bytes]:
        time.sleep(0.05)
        return [mbap(request, b"\x83\x0b")]

    master, slave = pty.openpty()
    with FakeServer(answer) as server:
        process = subprocess.Popen(
            [*COMMAND, server.url, "--units", "1-20"], stdout=subprocess.PIPE, stderr=slave
        )
        os.close(slave)
        shown = b""
        while True:
            try:
                shown += os.read(master, 4096)
            except OSError:
                break
        output, _ = process.communicate(timeout=20)
    os.close(master)
    assert b"of 20 asked, 0 found" in shown
    assert b"left at most\x1b[K" in shown
    assert b"\r\x1b[K" in shown  # it is gone before anything else is said
    assert output == b""
