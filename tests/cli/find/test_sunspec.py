"""
The command sunspec.
"""

from __future__ import annotations

import json

import pytest

from tests.support.commands import run
from tests.support.sunspec import chain, file_device, serving


def test_the_values_of_all_models_are_printed() -> None:
    with serving(file_device("device_1547.json")) as url:
        done = run("sunspec", url)
    assert (done.code, done.err) == (0, "")
    lines = [" ".join(line.split()) for line in done.out.splitlines()]
    assert "40004 common.Mn SunSpecTest" in lines
    assert any(line.endswith("DERMeasureAC.W 9800 W") for line in lines)
    assert not any("InvSt" in line for line in lines)


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
