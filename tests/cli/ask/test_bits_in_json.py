"""
Bits in JSON: true and false with a name or a type, as the outputs of fleets have them; 0 and 1
where cells of a table are read, and in text and CSV.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, Server
from tests.support.cases import each_case
from tests.support.commands import ended, run

METER = """\
name,table,address,type,count,bits,bit
pump,coils,5,,,,
valves,discrete_inputs,0,,2,,
ready,holding_registers,0,uint16,,,0
alarm,holding_registers,0,uint16,,,1
flags,holding_registers,0,uint16,,3=hot; 2=cold,
"""

VALUES = {
    "pump": True,
    "valves": [False, True],
    "ready": True,
    "alarm": False,
    "flags": {"hot": True, "cold": False},
}


@pytest.fixture
def url(tmp_path: Path) -> Iterator[str]:
    (tmp_path / "meter.csv").write_text(METER)
    mapping = Mapping(
        coils={5: [True]}, discrete_inputs={0: [False, True]}, holding_registers={0: [0b1001]}
    )
    with Server(Device(mapping)).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


def test_points_have_the_values_that_fleets_give_them(url: str, tmp_path: Path) -> None:
    done = run("read", url, "--map", tmp_path / "meter.csv", "--json")
    assert (done.code, done.err) == (0, "")
    read = json.loads(done.out)["values"]
    fleet = tmp_path / "fleet.toml"
    fleet.write_text(f"[defaults]\nmap = 'meter.csv'\n[[device]]\nname = 'a'\nurl = '{url}'\n")
    polled = [json.loads(each) for each in ended("poll", fleet, "--once").out.splitlines()]
    assert read == {each["name"]: each["value"] for each in polled} == VALUES
    for name, value in VALUES.items():
        assert type(read[name]) is type(value)


@each_case("item", [("coils", "5"), ("discrete", "1")])
def test_cells_are_numbers(url: str, item: tuple[str, str]) -> None:
    (found,) = json.loads(run("read", url, *item, "--json").out)["values"]
    assert found == 1
    assert type(found) is int


def test_bits_of_a_type_are_true_and_false(url: str) -> None:
    (found,) = json.loads(run("read", url, "holding", "0", "--type", "bits16", "--json").out)[
        "values"
    ]
    assert found == [True, False, False, True, *[False] * 12]


def test_text_and_csv_have_digits(url: str, tmp_path: Path) -> None:
    place = ("read", url, "--map", tmp_path / "meter.csv", "pump", "alarm")
    assert [line.split()[-1] for line in run(*place).out.splitlines()] == ["1", "0"]
    table = run(*place, "--csv").out
    assert ("True" in table, "true" in table, ",1" in table) == (False, False, True)
