"""
--audit: the file of the audit trail, rotated on SIGHUP, and what is said when it is wrong.
"""

import json
import signal
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Client, ServerDeviceFailure
from tests.cli.serving import serving
from tests.support.peers import until

TCP = "tcp://127.0.0.1:0"


def new_values(path: Path) -> list[Any]:
    lines = path.read_text().splitlines() if path.exists() else []
    events = [json.loads(line) for line in lines]
    return [each["changes"][0]["new"] for each in events if each["event"] == "write"]


def test_a_rotated_file_is_left_on_hangup(command: list[str], tmp_path: Path) -> None:
    path, before = tmp_path / "audit.json", tmp_path / "audit.json.1"
    with serving(*command, TCP, "--audit", path) as (process, url), Client(url) as plc:
        plc.write_register(0, 1)
        until(lambda: new_values(path) == [[1]])
        path.rename(before)
        process.send_signal(signal.SIGHUP)
        until(path.exists)
        plc.write_register(0, 2)
        until(lambda: new_values(path) == [[2]])
    assert new_values(before) == [[1]]


def test_writes_are_refused_while_the_disk_is_full(command: list[str]) -> None:
    """Nothing can be written to /dev/full, as the start of the server shows."""
    with serving(*command, TCP, "--audit", "/dev/full", "--audit-required") as (process, url):
        with Client(url) as plc:
            with pytest.raises(ServerDeviceFailure):
                plc.write_register(0, 2)
            assert plc.read_holding_registers(0, 1) == [0]
        assert process.stderr.readline() == "audit: OSError: [Errno 28] No space left on device\n"


@pytest.mark.parametrize("command", ["serve", "gateway"])
def test_what_changed_in_a_file_that_is_read_again_is_recorded(
    command: str, tmp_path: Path
) -> None:
    file, trail = tmp_path / "file.toml", tmp_path / "audit.json"
    options = [TCP, "--device", file]
    cells = "[[unit.holding_registers]]\naddress = 0\n"
    texts = [f"[[unit]]\nid = {number}\n{cells}" for number in (1, 2)]
    if command == "gateway":
        options = ["--config", file]
        head = f'listen = ["{TCP}"]\n'
        texts = [f'{head}[[route]]\nurl = "tcp://127.0.0.1:{port}"\n' for port in (1502, 1503)]
    file.write_text(texts[0])
    with serving(command, *options, "--audit", trail) as (process, _):
        file.write_text(texts[1])
        process.send_signal(signal.SIGHUP)
        until(lambda: "reload" in trail.read_text())
    found = [json.loads(line) for line in trail.read_text().splitlines()]
    assert sorted(each["event"] for each in found) == ["audit", "reload", "start", "stop"]
    (said,) = (each["result"] for each in found if each["event"] == "reload")
    assert said.startswith(f"{file}: read again, 1 ")
    assert "1 new" in said or "1 changed" in said
