"""
The command sunspec.
"""

from __future__ import annotations

import csv
import json

import pytest

from libmodbus_py import Device, Mapping, Server
from tests.support.commands import run
from tests.support.sunspec import chain, file_device, serving

IRRADIANCE = chain([302, 5, 812, 0xFFFF, 90, 0xFFFF, 0xFFFF])


def test_the_values_of_all_models_are_printed() -> None:
    with serving(file_device("device_1547.json")) as url:
        done = run("sunspec", url)
    assert (done.code, done.err) == (0, "")
    lines = [" ".join(line.split()) for line in done.out.splitlines()]
    assert "40004 common.Mn SunSpecTest" in lines
    assert any(line.endswith("DERMeasureAC.W 9800 W") for line in lines)
    assert not any("InvSt" in line for line in lines)


def test_json_has_null_and_csv_an_empty_cell_for_no_value() -> None:
    with serving(IRRADIANCE) as url:
        found = [json.loads(line) for line in run("sunspec", url, "--json").out.splitlines()]
        rows = list(csv.DictReader(run("sunspec", url, "--csv").out.splitlines()))
    values = [each["value"] for each in found]
    assert values == [302, 5, 812, None, 90, None, None]
    assert [row["value"] for row in rows] == ["302", "5", "812", "", "90", "", ""]
    assert [row["address"] for row in rows] == [str(at) for at in range(40002, 40009)]
    assert "has no value" in found[3]["reason"]
    assert found[2]["units"] == "W/m2"


@pytest.mark.parametrize(
    ("registers", "value"),
    [
        ([0, 0x0DD7, 0x4CC6, 0x448E], "0D:D7:4C:C6:44:8E"),
        ([0xABCD, 0, 0, 1], "00:00:00:00:00:01"),  # the padding may contain anything
        ([0, 0xFFFF, 0xFFFF, 0xFFFF], None),
    ],
)
def test_a_mac_address_is_shown_as_such(registers: list[int], value: str | None) -> None:
    with serving(chain([11, 13, 100, 0, 0, *registers, *[0] * 6])) as url:
        lines = [json.loads(line) for line in run("sunspec", url, "--json").out.splitlines()]
        table = run("sunspec", url).out
    (row,) = [line for line in lines if line["name"].endswith(".MAC")]
    assert row["value"] == value
    assert value is None or value in table


def test_a_device_without_models_and_a_wrong_base_fail_with_one_line() -> None:
    with serving([1, 2, 3]) as url:
        done = run("sunspec", url)
        assert (done.code, len(done.err.splitlines())) == (1, 1)
        assert "no SunS there" in done.err
        assert run("sunspec", url, "--base", "70000").code == 2


def test_notes_go_to_stderr() -> None:
    with serving(IRRADIANCE[:-2]) as url:
        done = run("sunspec", url)
    assert done.code == 0
    assert "has no end model" in done.err


def test_several_units_are_asked_and_one_may_have_no_models() -> None:
    with serving(IRRADIANCE) as url:
        table = run("sunspec", url, "-u", "1,2")
        as_json = run("sunspec", url, "-u", "1,2", "--json")
        as_csv = run("sunspec", url, "-u", "1,2", "--csv")
    lines = [json.loads(line) for line in as_json.out.splitlines()]
    rows = list(csv.DictReader(as_csv.out.splitlines()))
    assert table.code == 0
    headings = [line for line in table.out.splitlines() if line.startswith("unit")]
    assert headings == ["unit 1:", "unit 2:"]
    assert [line["unit"] for line in lines] == [1] * 7 + [2] * 7
    assert [int(row["unit"]) for row in rows] == [line["unit"] for line in lines]
    assert list(rows[0])[:2] == ["unit", "model"]


def test_a_unit_that_fails_beside_others_is_named() -> None:
    device = Device(Mapping(holding_registers={40000: IRRADIANCE}))
    with Server({1: device, 2: Device(Mapping())}).background("tcp://127.0.0.1:0") as running:
        done = run("sunspec", running.urls[0], "-u", "2,1")
    assert done.code == 1
    assert done.out.splitlines()[:2] == ["unit 2: no models", "unit 1:"]
    assert "no SunSpec models" in done.err
