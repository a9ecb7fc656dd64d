"""
Mistakes in what points mean: one line with file, line and key, in every format.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import load_map
from libmodbus_py.services.fleet.files import load as load_fleet
from libmodbus_py.tools.files.csv_text import csv_rows
from libmodbus_py.tools.files.texts import FileError, shown_key
from libmodbus_py.tools.simulator.device_file import load as load_device
from tests.support.cases import each_case

Keys = dict[str, Any]


def shown(value: Any) -> str:
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{shown_key(str(k))} = {shown(v)}' for k, v in value.items())} }}"
    return f'"{value}"' if isinstance(value, str) else str(value).lower()


def toml(head: str, keys: Keys) -> str:
    lines = [f"{key} = {shown(value)}" for key, value in keys.items()]
    return "\n".join([head, 'name = "b"', "address = 1", *lines, ""])


def toml_map(folder: Path, keys: Keys) -> Path:
    given = {"table": "holding_registers", **keys}
    (folder / "f.toml").write_text(toml("[[point]]", given))
    return folder / "f.toml"


def csv_map(folder: Path, keys: Keys) -> Path:
    cells = {"name": "b", "table": "holding", "address": "1"}
    for key, value in keys.items():
        names = value.items() if isinstance(value, dict) else ()
        cells[key] = "; ".join(f"{k} = {v}" for k, v in names) or (
            str(value).lower() if isinstance(value, bool) else str(value)
        )
    (folder / "f.csv").write_text(csv_rows([list(cells), list(cells.values())]))
    return folder / "f.csv"


def device_file(folder: Path, keys: Keys) -> Path:
    (folder / "f.toml").write_text(toml("[[unit]]\n[[unit.holding_registers]]", keys))
    return folder / "f.toml"


def fleet_file(folder: Path, keys: Keys) -> Path:
    head = '[[device]]\nname = "d"\nurl = "tcp://192.0.2.1"\n[[device.point]]'
    (folder / "f.toml").write_text(toml(head, {"table": "holding_registers", **keys}))
    return folder / "f.toml"


FORMATS: dict[str, tuple[Callable[[Path, Keys], Path], Callable[[Path], object], int]] = {
    "toml": (toml_map, load_map, 4),
    "csv": (csv_map, load_map, 0),
    "device file": (device_file, load_device, 4),
    "fleet file": (fleet_file, load_fleet, 7),
}
"""Format -> how it is written and read, and the lines above the keys."""

BAD_MEANINGS: list[tuple[Keys, str, str]] = [
    ({"states": {0: "x", 1: "x"}}, "states", "must have a name of its own; 'x' occurs twice"),
    ({"states": {70000: "x"}}, "states", "must be in 0..65535, not 70000"),
    ({"bits": {0: "x", 1: "x"}}, "bits", "must have a name of its own; 'x' occurs twice"),
    ({"bits": {3: "x", "2..5": "y"}}, "bits", "overlaps bits before it"),
    ({"bits": {16: "x"}}, "bits", "must be in 0..15, not 16"),
    ({"bits": {"9..4": "x"}}, "bits", "must be within 0..15, the lower number first"),
    ({"bit": 16}, "bit", "must be in 0..15, not 16"),
    ({"byte": "middle"}, "byte", "must be one of high, low"),
    ({"type": "uint32", "byte": "low"}, "byte", "must be left out for uint32"),
    ({"missing": 70000}, "missing", "must be in 0..65535, not 70000"),
    ({"type": "int16", "missing": -32769}, "missing", "must be in -32768..65535, not -32769"),
    ({"type": "string:4", "missing": 7}, "missing", 'must be "sunspec" for strings'),
    ({"type": "bcd16", "missing": "sunspec"}, "missing", "which SunSpec does not have"),
    ({"scale_from": "b"}, "scale_from", "must be another point, not the point itself"),
    ({"scale_from": "c"}, "scale_from", "the map has no point 'c'"),
    ({"scale_as": "factor"}, "scale_as", "must be left out without scale_from"),
    ({"plausible_minimum": 3, "plausible_maximum": 2}, "plausible_minimum", "must not be above"),
    ({"type": "date48", "never_falls": True}, "never_falls", "which has no numbers"),
    ({"type": "date48", "time_zone": "Mars/Base"}, "time_zone", "must be a time zone that this"),
    ({"time_zone": "Europe/Berlin"}, "time_zone", "for uint16, which is not a time"),
    ({"interval": 0}, "interval", "must be in 0.01..86400 seconds, not 0"),
    ({"interval": 86401}, "interval", "must be in 0.01..86400 seconds, not 86401"),
    ({"group": "x" * 101}, "group", "must have 0..100 characters, not 101"),
]


@each_case(("keys", "wrong", "reason"), BAD_MEANINGS)
@pytest.mark.parametrize("form", list(FORMATS))
def test_a_mistake_is_one_line_with_its_place(
    tmp_path_factory: pytest.TempPathFactory, form: str, keys: Keys, wrong: str, reason: str
) -> None:
    write, read, above = FORMATS[form]
    path = write(tmp_path_factory.mktemp("f"), keys)
    with pytest.raises(FileError) as caught:
        read(path)
    message = str(caught.value)
    line = list(keys).index(wrong) + above + 1 if above else 2
    assert message.startswith(f"{path}, line {line}")
    assert wrong in message.partition(str(path))[2]
    assert reason in message
    assert "\n" not in message
