"""--log and --log-format: what commands that run for long log, and how."""

import json
import logging
import re
import signal
from argparse import Namespace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Client
from libmodbus_py.cli.logs import logged
from tests.cli.serving import FLEET_OF_ONE
from tests.support.commands import PAGE_TOKEN, Started

LOGGER = logging.getLogger("libmodbus_py.somewhere")


def output(capsys: pytest.CaptureFixture[str], log: str | None, form: str | None) -> str:
    with logged(Namespace(log=log, log_format=form)):
        LOGGER.debug("a %s", "frame")
        LOGGER.info("a connection")
        LOGGER.warning("a line\nand another: %s", "\x1b[2J")
    LOGGER.error("later")
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("level", "count"), [("debug", 3), ("info", 2), ("warning", 1), ("error", 0), (None, 1)]
)
def test_messages_of_a_level_and_above_are_json_objects(level, count, capsys) -> None:
    entries = [json.loads(line) for line in output(capsys, level, "json").splitlines()]
    assert len(entries) == count
    if entries:
        last = entries[-1]
        assert (last["level"], last["logger"]) == ("warning", "libmodbus_py.somewhere")
        assert last["message"] == "a line\nand another: \x1b[2J"
        assert datetime.fromisoformat(last["time"]).tzinfo == UTC


@pytest.mark.parametrize(
    ("command", "code"),
    [
        ("serve tcp://{host}:0 --audit {folder}/trail --page {host}:0 -v", 0),
        ("gateway tcp://{host}:0 --to {device} --metrics 127.0.0.1:0 -v", 0),
        ("poll {folder}/fleet.toml --json --page 127.0.0.1:0", 0),
        ("poll {folder}/fleet.toml --once -v --csv {folder}/full/readings.csv", 1),
        ("serve {device}", 1),
        ("gateway tcp://127.0.0.1:0", 2),
    ],
)
def test_each_line_of_the_log_is_an_object(command, code, device: str, tmp_path) -> None:
    folder = tmp_path / "Kälte"
    folder.mkdir()
    (folder / "fleet.toml").write_text(FLEET_OF_ONE.format(url=device))
    words = command.format(folder=folder, device=device, host="0.0.0.0").split()
    options = ["--log", "info", "--log-format", "json"]
    environment = {**PAGE_TOKEN, "PYTHONIOENCODING": "ascii", "PYTHONWARNINGS": "error::Warning"}
    with Started(*words, *options, environment=environment) as process:
        lines = []
        while code == 0 and not any(sign in "".join(lines) for sign in ("listening on", "volts")):
            lines.append(process.stdout.readline())
        if "--audit" in words:
            process.send_signal(signal.SIGHUP)
        if code == 0:
            process.terminate()
        lines += [*process.stdout, *process.stderr]
        assert process.wait() == code
    assert lines
    assert all(isinstance(json.loads(line), dict) for line in lines)


def test_text_has_time_level_and_place(capsys: pytest.CaptureFixture[str]) -> None:
    line = output(capsys, "info", None).splitlines()[0]
    time, level, place, *words = line.split()
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", time)
    assert (level, place, words) == ("info", "somewhere:", ["a", "connection"])


@pytest.mark.parametrize("form", ["json", "text"])
def test_an_exception_is_shown_completely(form: str, capsys: pytest.CaptureFixture[str]) -> None:
    with logged(Namespace(log="info", log_format=form)):
        try:
            raise ValueError("wrong")
        except ValueError:
            LOGGER.exception("it failed")
    text = capsys.readouterr().err
    if form == "json":
        assert text.count("\n") == 1
        text = json.loads(text)["exception"]
    assert text.rstrip().endswith("ValueError: wrong")


def test_servers_tell_where_they_listen_and_every_frame(command: list[str]) -> None:
    options = ["--log", "debug", "--log-format", "json"]
    with Started(*command, "tcp://127.0.0.1:0", *options) as process:
        url = json.loads(process.stdout.readline())["message"].removeprefix("listening on ")
        with Client(url) as plc:
            plc.read_holding_registers(0, 1)
        process.terminate()
        assert process.wait() == 0
        entries: list[Any] = [json.loads(line) for line in process.stderr]
    assert any(entry["message"] == f"listening on {url}" for entry in entries)
    frames = [entry for entry in entries if entry["logger"] == "libmodbus_py.wire"]
    assert frames[0]["message"].startswith(url)


def test_poll_prints_its_frames(device: str, tmp_path: Path) -> None:
    file = tmp_path / "fleet.toml"
    file.write_text(FLEET_OF_ONE.format(url=device))
    with Started("poll", file, "--once", "-v") as process:
        lines = [line for line in process.stderr if "ReadHoldingRegisters" in line]
        assert process.wait() == 0
    assert [line.split()[1] for line in lines] == [">", "<"]
