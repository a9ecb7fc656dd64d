"""
read of several units, with an end of --watch, and output to a file.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, Server
from tests.support.cases import each_case
from tests.support.commands import on_terminal, run
from tests.support.peers import FakeServer, mbap


@pytest.fixture
def url() -> Iterator[str]:
    devices = {unit: Device(Mapping(holding_registers=20)) for unit in (1, 2, 17)}
    for unit, device in devices.items():
        device.mapping.holding_registers[0] = unit
    with Server(devices).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


def test_units_are_read_one_after_the_other(url: str) -> None:
    done = run("read", url, "-u", "1-2,17", "hr", 0)
    assert (done.code, done.err) == (0, "")
    assert done.out == "unit 1    1\nunit 2    2\nunit 17   17\n"


def test_a_unit_that_is_away_leaves_the_others(url: str) -> None:
    done = run("read", url, "-u", "2,3,17", "hr", 0)
    assert done.code == 1
    assert "unit 3: no values" in done.out
    assert done.out.endswith("unit 17   17\n")
    assert done.err.startswith("libmodbus-py: unit 3")
    assert done.err.count("\n") == 1


def test_json_and_csv_name_the_unit(url: str) -> None:
    lines = run("read", url, "-u", "2,3", "hr", 0, "--json").out.splitlines()
    first, second = map(json.loads, lines)
    assert (first["unit"], first["values"]) == (2, [2])
    assert second["unit"] == 3
    assert "error" in second
    rows = list(csv.reader(run("read", url, "-u", "2,3", "hr", 0, "--csv").out.splitlines()))
    assert rows[0] == ["time", "unit", "hr 0", "error"]
    assert rows[1][1:] == ["2", "2", ""]
    assert rows[2][1:3] == ["3", ""]


def test_what_json_prints_can_be_typed(url: str) -> None:
    found = json.loads(run("read", url, "4x", 0, "--type", "U16", "--order", "abcd", "--json").out)
    again = run(
        *("read", url, "-u", found["unit"], found["table"], found["address"], "--json"),
        *("--type", found["type"], "--order", found["order"]),
    )
    assert json.loads(again.out) == found


@each_case(
    ("end", "polls"),
    [
        (["--count", "3"], 3),
        (["--watch", "0.01", "--count", "2"], 2),
        (["--watch", "0.5", "--for", "10ms"], 1),
        (["--for", "0.01"], 1),
    ],
)
def test_a_watch_ends(url: str, end: list[str], polls: int) -> None:
    end = end if "--watch" in end or "--for" in end else [*end, "--watch", "0.01"]
    done = run("read", url, "hr", 0, *end)
    assert (done.code, done.err) == (0, "")
    assert done.out.count("\n") == polls


def test_a_watch_without_any_answer_ends_with_1(url: str) -> None:
    done = run("read", url, "-u", "9", "hr", 0, "--watch", "0.01", "--count", "2")
    assert done.code == 1
    assert done.out.count("\n") == 2


def test_several_units_are_watched(url: str) -> None:
    done = run("read", url, "-u", "1,17", "hr", 0, "--watch", "0.01", "--count", "2")
    texts = [line.partition("  ")[2] for line in done.out.splitlines()]
    assert texts == ["unit 1  1", "unit 17  17"] * 2
    end = ["--watch", "0.01", "--count", "3"]
    with on_terminal("read", url, "-u", "1,17", "hr", "0", *end) as terminal:
        terminal.until(lambda shown: "3 polls" in shown and shown.count("unit 17\r\n") >= 3)
        assert terminal.process.wait() == 0


@each_case("option", ["--csv", "--json"])
def test_output_goes_to_a_new_file(url: str, tmp_path: Path, option: str) -> None:
    path = tmp_path / f"log{option.replace('--', '.')}"
    done = run("read", url, option, path, "hr", 0)
    assert done == (0, "", "")
    assert path.read_text().count("\n") == (2 if option == "--csv" else 1)
    again = run("read", url, "hr", 0, option, path)
    assert again.code == 2
    assert f"{path} exists, and would be overwritten" in again.err
    other = tmp_path / f"without a suffix{option}"
    assert run("read", url, "hr", 0, f"{option}={other}").code == 0
    assert other.read_text()
    bare = tmp_path / f"bare{option}"  # a path, which says enough
    assert run("read", url, option, bare, "hr", 0).code == 0
    assert bare.read_text()


@each_case("option", ["--csv", "--json"])
def test_words_behind_the_option_are_no_files(url: str, option: str) -> None:
    assert run("read", option, url, "hr", 0).out
    assert run("read", url, option, "hr", 0).out
    assert run("read", url, "hr", 0, option).out


# --- identify and diagnose of several units ---------------------------------------


@pytest.fixture
def reporting() -> Iterator[str]:
    devices = {
        unit: Device(Mapping(holding_registers=1), identification={"VendorName": f"ACME {unit}"})
        for unit in (1, 2, 17)
    }
    with Server(devices).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


def test_units_are_identified_one_after_the_other(reporting: str) -> None:
    done = run("identify", reporting, "-u", "1-2,17", "--level", "0")
    assert (done.code, done.err) == (0, "")
    lines = done.out.splitlines()
    assert [line for line in lines if not line.startswith("  ")] == [
        "unit 1:",
        "unit 2:",
        "unit 17:",
    ]
    assert lines[1].split() == ["VendorName", "ACME", "1"]


def test_reports_of_a_unit_that_is_away(reporting: str) -> None:
    done = run("identify", reporting, "-u", "2,3,17", "--level", "0")
    assert done.code == 1
    assert "unit 3: no answer\nunit 17:\n  VendorName" in done.out
    assert done.err.startswith("libmodbus-py: unit 3")
    assert done.err.count("\n") == 1


def test_a_unit_that_has_neither_is_one_line_of_json() -> None:
    with FakeServer(lambda request: [mbap(request, bytes([request[7] | 0x80, 1]))]) as server:
        done = run("identify", server.url, "-u", "4-5", "--json")
    assert done.code == 1
    assert [json.loads(line)["unit"] for line in done.out.splitlines()] == [4, 5]
    assert done.out.count("has none of these") == 2


def test_a_sub_function_is_sent_to_each_unit(reporting: str) -> None:
    done = run("diagnose", reporting, "return-query-data", 7, "-u", "1,3,17")
    assert done.code == 1
    assert done.out == "unit 1: 7\nunit 3: no answer\nunit 17: 7\n"
    lines = run("diagnose", reporting, "0", "7", "-u", "1,3", "--json").out.splitlines()
    assert json.loads(lines[0]) == {"unit": 1, "return query data": 7}
    assert json.loads(lines[1])["unit"] == 3
