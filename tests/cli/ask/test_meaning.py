"""
The commands read and write with points that say what their registers mean.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Device, Mapping, Server, load_map
from tests.support.cases import each
from tests.support.commands import run

MAP = """
[[point]]
name = "v"
table = "holding_registers"
address = 0
type = "int16"
scale_from = "v_sf"
units = "V"

[[point]]
name = "v_sf"
table = "holding_registers"
address = 1
type = "int16"

[[point]]
name = "state"
table = "holding_registers"
address = 2
states = { 0 = "off", 1 = "on" }

[[point]]
name = "flags"
table = "holding_registers"
address = 3
bits = { 0 = "door", "4..7" = "mode" }

[[point]]
name = "at"
table = "holding_registers"
address = 4
type = "unix32"

[[point]]
name = "none"
table = "holding_registers"
address = 6
missing = 0
"""

CELLS = [2305, 0xFFFF, 1, 0x51, 0, 60, 0]


@pytest.fixture
def served(tmp_path: Path) -> Iterator[tuple[str, str, Device]]:
    (tmp_path / "map.toml").write_text(MAP)
    device = Device(Mapping(holding_registers={0: CELLS}))
    with Server(device).background("tcp://127.0.0.1:0") as serving:
        yield serving.urls[0], str(tmp_path / "map.toml"), device


Served = tuple[str, str, Device]


def test_values_are_printed_by_what_they_mean(served: Served) -> None:
    url, file, _ = served
    assert run("read", url, "--map", file).out == (
        "v      230.5 V\n"
        "v_sf      -1\n"
        "state  on\n"
        "flags  door=1 mode=5\n"
        "at     1970-01-01T00:01:00+00:00\n"
        "none       - (Missing)\n"
    )


def test_json_has_null_and_the_reason_for_no_value(served: Served) -> None:
    url, file, device = served
    found = json.loads(run("read", url, "--map", file, "--json").out)
    assert found["values"] == {
        "v": 230.5, "v_sf": -1, "state": "on", "flags": {"door": True, "mode": 5},
        "at": "1970-01-01T00:01:00+00:00", "none": None,
    }  # fmt: skip
    assert found["no_value"] == {"none": {"quality": "bad", "reason": "Missing"}}
    device.mapping.holding_registers[1] = 300
    found = json.loads(run("read", url, "v", "--map", file, "--json").out)
    assert found["values"] == {"v": None}
    assert found["no_value"] == {"v": {"quality": "bad", "reason": "BadScale"}}


def test_csv_has_an_empty_cell_and_the_reason(served: Served) -> None:
    url, file, _ = served
    titles, cells = csv.reader(run("read", url, "--map", file, "--csv").out.splitlines())
    found: dict[str, Any] = dict(zip(titles, cells, strict=True))
    assert (found["v (V)"], found["none"], found["error"]) == ("230.5", "", "none: Missing")
    assert found["flags"] == "door=1 mode=5"


def test_values_are_written_by_what_they_mean(served: Served) -> None:
    url, file, device = served
    words = ["v", "12.5", "state", "off", "flags", "mode=7", "at", "1970-01-01T00:02:00Z"]
    assert run("write", url, *words, "--map", file).code == 0
    assert device.mapping.holding_registers[0:7] == [125, 0xFFFF, 0, 0x71, 0, 120, 0]


def test_no_scale_is_read_for_a_dry_run(served: Served) -> None:
    url, file, _ = served
    done = run("write", url, "v", "1", "--map", file, "--dry-run")
    assert (done.code, done.out) == (2, "")
    assert "--dry-run asks no device, and v_sf of the device is the scale" in done.err


# --- what is typed behind write ---------------------------------------------------


TYPED_MAP = """\
name,table,address,type,states,bits,bit,time zone
state,holding,0,,0 = off; 1 = on,,,
flags,holding,1,,,0 = door; 4..7 = mode,,
clock,holding,2,unix32,,,,
local,holding,4,date48,,,,Europe/Berlin
flag,holding,7,,,,3,
"""

NOON = datetime(2026, 7, 1, 12, tzinfo=UTC)

# Name, text, value, or the error with which the command refuses it.
TYPED = [
    ("state", "on", "on"),
    ("state", "0", "off"),
    ("flags", "door=1, mode=5", {"door": True, "mode": 5}),
    ("flags", '{"door": false, "mode": 7}', {"door": False, "mode": 7}),
    ("clock", "2026-07-01T14:00:00+02:00", NOON),
    ("local", "2026-07-01T12:00:00Z", NOON),
    ("flag", "1", True),
    ("state", "up", ValueError("value must")),
    ("flags", '{"door": 1, "door": 0}', ValueError("value.door: occurs twice")),
    ("clock", "2026-07-01T12:00:00", ValueError("value must")),
]


def test_every_kind_of_value_can_be_typed(tmp_path: Path) -> None:
    path = tmp_path / "map.csv"
    path.write_text(TYPED_MAP)
    device = Device.of_map(load_map(path))
    with Server(device).background("tcp://127.0.0.1:0") as serving:
        for check, (name, text, value) in each(TYPED):
            before = device[name]
            done = run("write", serving.urls[0], "--map", str(path), name, text)
            refused = str(value) if isinstance(value, ValueError) else None
            with check:
                assert (done.code == 0) is (refused is None), done.err
                assert device[name] == (before if refused else value)
                assert (refused or "") in done.err
