"""poll on a terminal and on a page: values and what is down, within the size of the terminal."""

import io
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.cli.output import RedrawnLines
from tests.support.cases import each_case
from tests.support.commands import PAGE_TOKEN, Started, on_terminal, page_url
from tests.tools.page.watching import Visitor

METER = "name,table,address,unit,scale\nlevel,holding_registers,0,m,0.1\n"


@each_case(
    ("columns", "rows", "text"), [(80, 24, 9), (80, 6, 5), (80, 2, 1), (80, 1, 1), (3, 24, 9)]
)
def test_the_drawing_fits_the_terminal(monkeypatch, columns, rows, text) -> None:
    size = os.terminal_size((columns, rows))
    monkeypatch.setattr("shutil.get_terminal_size", lambda: size)
    stream = io.StringIO()
    table = RedrawnLines(stream)
    lines = [(f"line {at} \x1b[2J" + "x" * 200, False) for at in range(9)]
    table.draw(lines)
    first = stream.getvalue().split("\n")[:-1]
    assert len(first) == text
    assert all(len(line) < columns and "\x1b" not in line for line in first)
    table.draw(lines[:1])
    assert f"\x1b[{text}A\r\x1b[J" in stream.getvalue()
    table.clear()
    table.clear()
    assert stream.getvalue().endswith("\x1b[1A\r\x1b[J")


def test_a_terminal_shows_values_and_is_left_in_order(tmp_path: Path) -> None:
    (tmp_path / "meter.csv").write_text(METER)
    devices: Any = {1: Device(Mapping(holding_registers={0: [17]}))}
    with Server(devices).background("tcp://127.0.0.1:0") as running:
        text = f"[defaults]\nmap = 'meter.csv'\ninterval = 0.05\nurl = '{running.urls[0]}'\n"
        for unit, name in ((1, "north"), (2, "south")):
            text += f"[[device]]\nname = '{name}'\nunit = {unit}\n"
        (tmp_path / "fleet.toml").write_text(text)
        environment = {"TERM": "xterm"}
        with on_terminal("poll", tmp_path / "fleet.toml", environment=environment) as terminal:
            terminal.until(lambda frame: "level" in frame and "1.7 m" in frame)
            terminal.until(lambda frame: "south is down since" in frame)
            terminal.until(lambda frame: frame.count("1.7 m") > 1)
            terminal.process.send_signal(signal.SIGINT)
            output = terminal.read_to_end()
    assert "\r\x1b[J" in output
    assert "polls in" in output.rpartition("\x1b[J")[2]  # the summary is what remains


TANK = "name,table,address,unit\nlevel,holding_registers,0,m\npressure,holding_registers,1,bar\n"


@pytest.fixture
def tank(tmp_path: Path) -> Iterator[Path]:
    (tmp_path / "meter.csv").write_text(TANK)
    mapping = Mapping(holding_registers={0: [17, 4]})
    with Server(Device(mapping)).background("tcp://127.0.0.1:0") as running:
        text = f"[defaults]\nmap = 'meter.csv'\ninterval = 0.02\nurl = '{running.urls[0]}'\n"
        (tmp_path / "plant.toml").write_text(text + "[[device]]\nname = 'one'\n")
        yield tmp_path / "plant.toml"


def test_the_fleet_is_shown_and_follows_its_file(tank: Path) -> None:
    command = ("poll", tank, "--page", "127.0.0.1:0")
    with Started(*command, environment=PAGE_TOKEN) as process:
        visitor = Visitor(page_url(process.stderr.readline()))
        with visitor.watching():
            head = visitor.seen["head"]
            assert (head["kind"], head["title"]) == ("fleet", "plant.toml")
            visitor.look_at()
            visitor.receive(lambda: len(visitor.rows("rows")) == 3)
            assert visitor.rows("rows")[0]["name"]["own"] == "one"
            visitor.receive(
                lambda: (
                    [
                        [*row["name"].values(), *row["value"].values()]
                        for row in visitor.rows("rows")[1:]
                    ]
                    == [["one", "level", "17", "m"], ["one", "pressure", "4", "bar"]]
                )
            )
            text = tank.read_text()
            for number in range(20):
                tank.write_text(text.replace("'one'", f"'d{number}'"))
                for _ in range(2):  # the second perhaps before the first was answered
                    process.send_signal(signal.SIGHUP)
            visitor.receive(lambda: visitor.rows("rows")[0]["name"]["own"] == "d19")
            visitor.receive(
                lambda: visitor.rows("rows")[1]["value"] == {"text": "17", "units": "m"}
            )
            assert len(visitor.rows("rows")) == 3
        process.send_signal(signal.SIGINT)
        assert process.wait() == 0
        assert process.stdout.read() == ""
