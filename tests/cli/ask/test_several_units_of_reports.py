"""
identify and diagnose of several units.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest

from libmodbus_py import Device, Mapping, Server
from tests.support.cases import each_case
from tests.support.commands import run
from tests.support.peers import FakeServer, mbap, refusing, url_of


@pytest.fixture
def url() -> Iterator[str]:
    devices = {
        unit: Device(Mapping(holding_registers=1), identification={"VendorName": f"ACME {unit}"})
        for unit in (1, 2, 17)
    }
    with Server(devices).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


def test_units_are_identified_one_after_the_other(url: str) -> None:
    done = run("identify", url, "-u", "1-2,17", "--level", "0")
    assert (done.code, done.err) == (0, "")
    lines = done.out.splitlines()
    assert [line for line in lines if not line.startswith("  ")] == [
        "unit 1:",
        "unit 2:",
        "unit 17:",
    ]
    assert lines[1].split() == ["VendorName", "ACME", "1"]


def test_a_unit_that_is_away_leaves_the_others(url: str) -> None:
    done = run("identify", url, "-u", "2,3,17", "--level", "0")
    assert done.code == 1
    assert "unit 3: no answer\nunit 17:\n  VendorName" in done.out
    assert done.err.startswith("libmodbus-py: unit 3")
    assert done.err.count("\n") == 1


def test_json_is_a_line_for_each_unit(url: str) -> None:
    lines = run("identify", url, "-u", "2,3", "--level", "0", "--json").out.splitlines()
    first, second = map(json.loads, lines)
    assert (first["unit"], first["VendorName"]) == (2, "ACME 2")
    assert second["unit"] == 3
    assert "unit 3" in second["error"]


def test_a_unit_that_has_neither_is_one_line_of_json() -> None:
    with FakeServer(lambda request: [mbap(request, bytes([request[7] | 0x80, 1]))]) as server:
        done = run("identify", server.url, "-u", "4-5", "--json")
    assert done.code == 1
    assert [json.loads(line)["unit"] for line in done.out.splitlines()] == [4, 5]
    assert done.out.count("has none of these") == 2


def test_a_single_unit_is_printed_as_before(url: str) -> None:
    assert run("identify", url, "-u", 2).out == run("identify", f"{url}?unit=2").out
    assert not run("identify", url, "-u", 2).out.startswith("unit")


def test_units_are_diagnosed_one_after_the_other(url: str) -> None:
    done = run("diagnose", url, "-u", "1,17")
    assert (done.code, done.err) == (0, "")
    assert done.out.count("  bus message count ") == 2
    assert done.out.index("unit 1:\n") < done.out.index("unit 17:\n")


def test_a_sub_function_is_sent_to_each_unit(url: str) -> None:
    done = run("diagnose", url, "return-query-data", 7, "-u", "1,3,17")
    assert done.code == 1
    assert done.out == "unit 1: 7\nunit 3: no answer\nunit 17: 7\n"
    lines = run("diagnose", url, "0", "7", "-u", "1,3", "--json").out.splitlines()
    assert json.loads(lines[0]) == {"unit": 1, "return query data": 7}
    assert json.loads(lines[1])["unit"] == 3


@each_case("command", ["identify", "diagnose"])
def test_a_lost_connection_ends_the_command(command: str) -> None:
    with refusing() as bound:
        done = run(command, url_of(bound), "-u", "1-9")
    assert (done.code, done.out) == (1, "")
    assert done.err.count("\n") == 1
