"""
The same words on every command, and what is said about words that a command does not know.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Client, Device, Mapping, Server
from tests.support.cases import each_case
from tests.support.commands import Started, run

DECODED = Path(__file__).parents[1] / "tools" / "listener" / "decoded.pcapng"


@pytest.fixture
def url() -> Iterator[str]:
    devices = {unit: Device(Mapping(holding_registers=20)) for unit in (1, 2, 17)}
    with Server(devices).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


@each_case("word", ["-u", "--unit", "--units"])
def test_scan_takes_the_words_of_read(url: str, word: str) -> None:
    found = json.loads(run("scan", url.removeprefix("tcp://"), word, "2,3,17", "--json").out)
    assert [each["unit"] for each in found["found"]] == [2, 17]


@each_case(
    ("words", "tried"),
    [
        (["-b", "9600", "-p", "none", "-u", "1"], "1 unit, "),
        (["-b", "9600,19200", "-p", "none,Even,O", "-u", "1-2"], "2 units at 6 settings, "),
        (["--baudrate", "9600", "--parity", "n,N,none", "--unit", "1"], "1 unit, "),
        (["--baudrates", "9600", "--parities", "E,N", "--units", "1"], "1 unit at 2 settings, "),
    ],
)
def test_scan_of_a_line_takes_them(words: list[str], tried: str) -> None:
    assert run("scan", "/dev/no-such", *words).err.startswith(tried)


def test_serve_has_the_units_that_were_typed() -> None:
    with Started("serve", "127.0.0.1:0", "-u", "3,5-6") as process:
        url = process.stdout.readline().removeprefix("listening on ").strip()
        with Client(url, timeout=5) as plc:
            plc.for_unit(3).write_register(0, 7)
            assert plc.for_unit(6).read_holding_registers(0, 1) == [0]
        assert run("read", url, "-u", "4", "hr", 0).code == 1
        process.terminate()
        assert process.wait() == 0


def test_a_gateway_has_the_units_that_were_typed(url: str) -> None:
    to = url.removeprefix("tcp://")
    with Started("gateway", "127.0.0.1:0", "--to", to, "-u", "2") as process:
        place = process.stdout.readline().removeprefix("listening on ").strip()
        assert run("read", place, "-u", "2", "hr", 0).code == 0
        done = run("read", place, "-u", "1", "hr", 0)
        assert "gateway path unavailable (exception 10)" in done.err
        process.terminate()
        assert process.wait() == 0


def test_listen_prints_the_units_that_were_typed() -> None:
    everything = [json.loads(line) for line in run("listen", DECODED, "--json").out.splitlines()]
    units = {each.get("unit") for each in everything[:-1]}
    unit = min(each for each in units if each is not None)
    assert len(units) > 1
    some = [
        json.loads(line) for line in run("listen", DECODED, "-u", unit, "--json").out.splitlines()
    ]
    assert some[:-1] == [each for each in everything[:-1] if each["unit"] == unit]
