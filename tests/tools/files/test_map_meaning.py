"""
Keys that say what raw values mean, in TOML and in CSV: the same points, and where mistakes are.
"""

from __future__ import annotations

from pathlib import Path

from libmodbus_py import RegisterMap, load_map

TOML = """
[[point]]
name = "v"
table = "holding_registers"
address = 0
type = "int16"
missing = "sunspec"
scale_from = "v_sf"
plausible_maximum = 500

[[point]]
name = "v_sf"
table = "holding_registers"
address = 1
type = "int16"
missing = 0x8000

[[point]]
name = "state"
table = "holding_registers"
address = 2
states = { 0 = "off", 1 = "on", 0x10 = "a;b" }
missing = [255, 65535]

[[point]]
name = "flags"
table = "holding_registers"
address = 3
bits = { 0 = "door", "4..7" = "mode" }

[[point]]
name = "flag"
table = "holding_registers"
address = 3
bit = 3

[[point]]
name = "mode"
table = "holding_registers"
address = 4
byte = "high"
never_falls = true

[[point]]
name = "at"
table = "holding_registers"
address = 5
type = "iec870"
"""

CSV = """\
name,table,address,type,missing,scale_from,plausible maximum,states,bits,bit,byte,Never falls
v,holding,0,int16,sunspec,v_sf,500,,,,,
v_sf,holding,1,sunssf,0x8000,,,,,,,
state,holding,2,,255; 65535,,,"{""0"": ""off"", ""1"": ""on"", ""16"": ""a;b""}",,,,
flags,holding,3,,,,,,0 = door; 4..7 = mode,,,
flag,holding,3,,,,,,,3,,
mode,holding,4,,,,,,,,high,true
at,holding,5,iec870,,,,,,,,
"""


def loaded(folder: Path, name: str, text: str) -> RegisterMap:
    (folder / name).write_text(text)
    return load_map(folder / name)


def test_toml_and_csv_say_the_same(tmp_path: Path) -> None:
    points = loaded(tmp_path, "map.toml", TOML)
    assert list(loaded(tmp_path, "map.csv", CSV).values()) == list(points.values())
    assert points["state"].states == {0: "off", 1: "on", 16: "a;b"}
    assert points["flags"].decode([0x51]) == {"door": True, "mode": 5}


def test_an_accumulator_of_sunspec_is_missing_at_0(tmp_path: Path) -> None:
    text = "name,table,address,type,missing\nenergy,holding,0,acc32,sunspec\n"
    point = loaded(tmp_path, "map.csv", text)["energy"]
    assert (point.decode([0, 0]), point.decode([0xFFFF, 0xFFFF])) == (None, 0xFFFFFFFF)
