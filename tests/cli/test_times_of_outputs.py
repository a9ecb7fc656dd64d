"""
Every output of the command line writes times in one form.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, Server
from tests.support.commands import ended, run

FORM = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z")

CAPTURE = Path(__file__).parents[1] / "tools" / "listener" / "decoded.pcapng"


@pytest.fixture
def url() -> Iterator[str]:
    with Server(Device(Mapping(holding_registers=2))).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


def test_a_watch_in_json_csv_and_text(url: str) -> None:
    watch = ("read", url, "hr", 0, "--watch", "0.01", "--count", "1")
    assert FORM.fullmatch(json.loads(run(*watch, "--json").out)["time"])
    assert FORM.fullmatch(run(*watch, "--csv").out.splitlines()[1].split(",")[0])
    assert FORM.fullmatch(run(*watch).out.split()[0])


def test_a_poll_that_failed() -> None:
    done = run("read", "127.0.0.1:1", "hr", 0, "--watch", "0.01", "--count", "1", "--json")
    assert FORM.fullmatch(json.loads(done.out)["time"])


def test_transactions_that_were_heard() -> None:
    lines = [json.loads(line) for line in run("listen", CAPTURE, "--json").out.splitlines()]
    times = [line["time"] for line in lines if "time" in line]
    assert times
    assert all(FORM.fullmatch(each) for each in times)
    assert times == sorted(times)


def test_readings_of_a_fleet(url: str, tmp_path: Path) -> None:
    (tmp_path / "map.csv").write_text("name,table,address\nlevel,holding,0\n")
    (tmp_path / "fleet.toml").write_text(
        f'[[device]]\nname = "one"\nurl = "{url}"\nmap = "map.csv"\n'
    )
    done = ended("poll", tmp_path / "fleet.toml", "--once", "--json", "--log", "debug")
    assert FORM.fullmatch(json.loads(done.out.splitlines()[0])["time"])
    for line in done.err.splitlines():
        assert FORM.fullmatch(line.split()[0])
    assert done.err
