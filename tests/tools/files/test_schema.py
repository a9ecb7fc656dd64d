"""The keys of files, each with an example in every format."""

import runpy
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Point, RegisterMap, load, load_map
from libmodbus_py.files.csv_text import CELLS
from libmodbus_py.files.schema import in_bytes, in_seconds
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.maps.list_cells import READERS
from libmodbus_py.maps.map_file import POINT
from libmodbus_py.services.fleet import files as fleet_files
from libmodbus_py.services.fleet.config import devices_from_json, devices_to_json
from libmodbus_py.services.fleet.files import load as load_fleet
from libmodbus_py.tools.files.map_texts import class_text, csv_text, toml_text
from libmodbus_py.tools.simulator.device_file import load as load_device
from tests.support.cases import each_case
from tests.support.golden import Refused


def test_every_key_that_csv_has_a_column_for_can_be_in_a_cell() -> None:
    assert set(POINT) <= set(READERS)
    not_in_cells = {"map", "dead_bands", "labels"}
    columns = {key.name for key in fleet_files.DEVICE.values() if key.kind in CELLS}
    assert columns == set(fleet_files.DEVICE) - not_in_cells


DEVICE_TEXT = """
[[device]]
name = "a"
map = "sdm120"
url = "rtu:///dev/ttyUSB0"
"""
ROUTE_TEXT = """
[[route]]
url = "rtu:///dev/ttyUSB0"
"""
POINT_TEXT = """
[[point]]
name = "a"
table = "coils"
address = 3
"""
SERIAL = "stop_bits is part of the URL of a serial port: rtu:///dev/ttyUSB0?stop_bits=..."


@each_case(
    ("text", "suggestion"),
    [
        (DEVICE_TEXT + "stopbits = 2", SERIAL),
        (DEVICE_TEXT + "slave = 2", "did you mean unit?"),
        (DEVICE_TEXT + "intervall = 2", "did you mean interval?"),
        (ROUTE_TEXT + "stopbits = 2", SERIAL),
        (ROUTE_TEXT + "unit = 2", "did you mean units?"),
        (POINT_TEXT + "data_type = 'uint16'", "did you mean type?"),
        ("[[unit]]\nid = 1\nidentity = {}", "did you mean identification?"),
    ],
)
def test_a_wrong_key_has_a_suggestion(tmp_path: Path, text: str, suggestion: str) -> None:
    file = tmp_path / "wrong.toml"
    file.write_text(text)
    with pytest.raises(ValueError, match="no such key; allowed are ") as raised:
        load(file)
    assert str(raised.value).endswith(f"; {suggestion}")


def test_amounts_may_have_units() -> None:
    for text, value in (("90 days", 7_776_000), ("1.5h", 5400), ("2 weeks", 1_209_600)):
        assert in_seconds("keep", text, "1 s", "100 years") == value
    for text, value in (("2 GB", 2 * 10**9), ("1 GiB", 1 << 30), ("0.5 MB", 500_000)):
        assert in_bytes("size", text, "1 B", "1 TB") == value


def test_a_wrong_amount_is_named_with_what_is_allowed(refused: Refused) -> None:
    refused("wrong_amounts.txt", lambda amount: in_seconds("keep", amount, "1 minute", "100 years"))


H = "holding_registers"

# For each key of `Point` a point that has it, and a value other than its default.
EXAMPLES: dict[str, dict[str, Any]] = {
    "name": {"name": "x y"},
    "table": {"table": "coils"},
    "address": {"address": 7},
    "count": {"count": 3},
    "type": {"type": "float32"},
    "order": {"type": "float32", "order": "CDAB"},
    "encoding": {"type": "string:8", "encoding": "latin-1"},
    "padding": {"type": "string:8", "padding": " "},
    "scale": {"scale": 0.1},
    "offset": {"offset": -5},
    "units": {"units": "kWh"},
    "access": {"access": "read"},
    "minimum": {"minimum": 3},
    "maximum": {"maximum": 3},
    "description": {"description": "of the house"},
    "missing": {"missing": [0, 65535]},
    "plausible_minimum": {"plausible_minimum": 1},
    "plausible_maximum": {"plausible_maximum": 500.5},
    "never_falls": {"never_falls": True},
    "scale_from": {"scale_from": "sf"},
    "scale_as": {"scale_from": "sf", "scale_as": "factor"},
    "states": {"states": {0: "off", 1: "a;b=c{", "2..9": "off", "else": "?"}},
    "bits": {"bits": {0: "door", "4..7": "code"}},
    "bit": {"bit": "4..7"},
    "byte": {"byte": "high"},
    "time_zone": {"type": "date48", "time_zone": "Europe/Berlin"},
    "interval": {"interval": 60.5},
    "border": {"border": True},
    "group": {"group": "slow"},
    "rewrite": {"rewrite": 30},
    "initial": {"initial": [1, 2], "count": 2},
    "write_function": {"write_function": "multiple"},
}

SCALE = Point("sf", H, 100, access="read")


def test_every_key_has_an_example() -> None:
    assert list(EXAMPLES) == [field.name for field in fields(Point) if field.init]


def points_of(key: str) -> list[Point]:
    return [Point(**{"name": "it", "table": H, "address": 0, **EXAMPLES[key]}), SCALE]


def from_toml(folder: Path, points: list[Point]) -> list[Point]:
    (folder / "map.toml").write_text(toml_text(points))
    return list(load_map(folder / "map.toml").values())


def from_csv(folder: Path, points: list[Point]) -> list[Point]:
    (folder / "map.csv").write_text(csv_text(points))
    return list(load_map(folder / "map.csv").values())


def from_device_file(folder: Path, points: list[Point]) -> list[Point]:
    """Return the points of a unit that are written in the device file itself."""
    text = "[[unit]]\n"
    for entry in points:  # the name of the list says the table
        point = toml_text([entry]).replace(f'table = "{entry.table}"\n', "")
        text += point.replace("[[point]]", f"[[unit.{entry.table}]]")
    (folder / "device.toml").write_text(text)
    device = load_device(folder / "device.toml").devices
    assert not isinstance(device, dict)
    return [device.points[point.name] for point in points]


def from_fleet_file(folder: Path, points: list[Point]) -> list[Point]:
    """Return the points of a device that are written in the fleet file itself."""
    head = '[[device]]\nname = "d"\nurl = "tcp://192.0.2.1"\n'
    text = toml_text(points).replace("[[point]]", "[[device.point]]")
    (folder / "fleet.toml").write_text(head + text)
    (device,) = load_fleet(folder / "fleet.toml").devices
    return list(device.map.values())


def from_json(folder: Path, points: list[Point]) -> list[Point]:
    device = DeviceConfig("d", "tcp://192.0.2.1", RegisterMap(points))
    (copy,) = devices_from_json(devices_to_json([device]))
    return list(copy.map.values())


def from_class(folder: Path, points: list[Point]) -> list[Point]:
    (folder / "it.py").write_text(class_text(RegisterMap(points), "it"))
    return list(runpy.run_path(str(folder / "it.py"))["MAP"].values())


FORMATS: dict[str, Callable[[Path, list[Point]], list[Point]]] = {
    "toml": from_toml,
    "csv": from_csv,
    "device file": from_device_file,
    "fleet file": from_fleet_file,
    "json": from_json,
    "class": from_class,
}


@each_case("key", list(EXAMPLES))
@pytest.mark.parametrize("form", list(FORMATS))
def test_each_file_format_has_the_key(tmp_path_factory, form, key) -> None:
    points = points_of(key)
    if form == "device file":  # where it is called `value`
        points = [replace(point, initial=None) for point in points]
    assert FORMATS[form](tmp_path_factory.mktemp("file"), points) == points
