"""
--audit: the file of the audit trail, rotated on SIGHUP, and what is said when it is wrong.
"""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Context, Device, Mapping, Server, ServerDeviceFailure
from tests.support.commands import Started, run
from tests.support.peers import until


@pytest.fixture(params=["serve", "gateway"])
def command(request: pytest.FixtureRequest) -> Iterator[list[str]]:
    if request.param == "serve":
        yield ["serve", "tcp://127.0.0.1:0"]
        return
    with Server(Device(Mapping(holding_registers=10))).background("tcp://127.0.0.1:0") as running:
        yield ["gateway", "tcp://127.0.0.1:0", "--to", running.urls[0]]


def new_values(path: Path) -> list[Any]:
    lines = path.read_text().splitlines() if path.exists() else []
    events = [json.loads(line) for line in lines]
    return [each["changes"][0]["new"] for each in events if each["event"] == "write"]


def test_a_rotated_file_is_left_on_hangup(command: list[str], tmp_path: Path) -> None:
    path, before = tmp_path / "audit.json", tmp_path / "audit.json.1"
    with Started(*command, "--audit", path) as process:
        url = process.stdout.readline().removeprefix("listening on ").rstrip("\n")
        with Context.from_url(url) as plc:
            plc.write_register(0, 1)
            until(lambda: new_values(path) == [[1]])
            path.rename(before)
            process.send_signal(signal.SIGHUP)
            until(path.exists)
            plc.write_register(0, 2)
            until(lambda: new_values(path) == [[2]])
        process.terminate()
        assert process.wait() == 0
    assert new_values(before) == [[1]]


def test_writes_are_refused_while_the_disk_is_full(command: list[str]) -> None:
    """Nothing can be written to /dev/full, as the start of the server shows."""
    with Started(*command, "--audit", "/dev/full", "--audit-required") as process:
        url = process.stdout.readline().removeprefix("listening on ").rstrip("\n")
        with Context.from_url(url) as plc:
            with pytest.raises(ServerDeviceFailure):
                plc.write_register(0, 2)
            assert plc.read_holding_registers(0, 1) == [0]
        assert process.stderr.readline() == "audit: OSError: [Errno 28] No space left on device\n"
        process.terminate()
        assert process.wait() == 0


def test_wrong_options_are_told_in_a_line(command: list[str], tmp_path: Path) -> None:
    for options, said in (
        (["--audit-required"], "--audit-required needs --audit"),
        (["--audit", tmp_path], f"--audit: {tmp_path}: Is a directory"),
        (["--audit", tmp_path / "no" / "file"], "No such file or directory"),
    ):
        done = run(*command, *options)
        assert done.code == 2, done
        assert said in done.err
        assert done.err.count("\n") == 1
