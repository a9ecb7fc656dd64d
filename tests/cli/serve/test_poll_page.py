"""
poll --page: the values of a fleet in a browser, while its file is read again.
"""

from __future__ import annotations

import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, Server
from tests.support.commands import PAGE_TOKEN, Started, page_url, run
from tests.tools.page.watching import Visitor

METER = "name,table,address,unit\nlevel,holding_registers,0,m\npressure,holding_registers,1,bar\n"


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Path]:
    (tmp_path / "meter.csv").write_text(METER)
    mapping = Mapping(holding_registers={0: [17, 4]})
    with Server(Device(mapping)).background("tcp://127.0.0.1:0") as running:
        text = f"[defaults]\nmap = 'meter.csv'\ninterval = 0.02\nurl = '{running.urls[0]}'\n"
        (tmp_path / "plant.toml").write_text(text + "[[device]]\nname = 'one'\n")
        yield tmp_path / "plant.toml"


def test_the_fleet_is_shown_and_follows_its_file(fleet: Path) -> None:
    command = ("poll", fleet, "--page", "127.0.0.1:0")
    with Started(*command, environment=PAGE_TOKEN) as process:
        visitor = Visitor(page_url(process.stderr.readline()))
        with visitor.watching():
            head = visitor.seen["head"]
            assert (head["kind"], head["title"]) == ("fleet", "plant.toml")
            visitor.look_at()
            visitor.receive(lambda: len(visitor.rows("rows")) == 3)
            assert visitor.rows("rows")[0][0][1] == "one"
            visitor.receive(
                lambda: (
                    [[each[0], each[2]] for each in visitor.rows("rows")[1:]]
                    == [[["one", "level"], ["17", "m"]], [["one", "pressure"], ["4", "bar"]]]
                )
            )
            fleet.write_text(fleet.read_text().replace("'one'", "'two'"))
            process.send_signal(signal.SIGHUP)
            visitor.receive(lambda: visitor.rows("rows")[0][0][1] == "two")
            visitor.receive(lambda: visitor.rows("rows")[1][2] == ["17", "m"])
        process.send_signal(signal.SIGINT)
        assert process.wait() == 0
        assert process.stdout.read() == ""


def test_an_address_in_use_is_told(fleet: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        place = f"127.0.0.1:{taken.getsockname()[1]}"
        done = run("poll", fleet, "--page", place, environment=PAGE_TOKEN)
    assert done.code == 1
    assert f"cannot show a page on {place}: Address already in use" in done.err


@pytest.mark.parametrize(
    "command",
    [
        ("poll", "plant.toml"),
        ("gateway", "tcp://127.0.0.1:0", "--to", "tcp://127.0.0.1:1"),
        ("read", "tcp://127.0.0.1:9", "holding", "0", "--watch", "1"),
    ],
)
def test_a_token_needs_a_page(fleet: Path, command: tuple[str, ...]) -> None:
    given = [str(fleet) if each == "plant.toml" else each for each in command]
    done = run(*given, "--page-token", "file")
    assert (done.code, "--page-token needs --page" in done.err) == (2, True)
