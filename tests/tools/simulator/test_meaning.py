"""
Simulated devices whose maps say what registers mean: their values, and what a page shows.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from libmodbus_py import Device
from libmodbus_py.device_file import DeviceFileError, load
from libmodbus_py.tools.page.samples import Samples
from libmodbus_py.tools.page.server_source import set_point
from libmodbus_py.tools.page.units import ShownUnit, point_rows
from libmodbus_py.tools.simulator.device_file import parse
from libmodbus_py.tools.simulator.simulated import SimulatedDevice

MAP = """
[[point]]
name = "v"
table = "holding_registers"
address = 0
type = "int16"
scale_from = "v_sf"

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
name = "flag"
table = "holding_registers"
address = 3
bit = 3

[[point]]
name = "mode"
table = "holding_registers"
address = 3
bit = "4..7"

[[point]]
name = "flags"
table = "holding_registers"
address = 4
bits = { 0 = "door", 1 = "alarm" }

[[point]]
name = "level"
table = "holding_registers"
address = 5
missing = 0
"""

DEVICE = """
[[unit]]
map = "map.toml"

[unit.values]
v = 230.5
v_sf = -1
state = "on"
flag = true
mode = 5
flags = { alarm = true }
"""


@pytest.fixture
def device(tmp_path: Path) -> Device:
    (tmp_path / "map.toml").write_text(MAP)
    (tmp_path / "device.toml").write_text(DEVICE)
    found = load(tmp_path / "device.toml").devices
    return found if isinstance(found, Device) else next(iter(found.values()))


def test_values_of_device_files_are_what_points_mean(device: Device) -> None:
    assert device.mapping.holding_registers[0:6] == [2305, 0xFFFF, 1, 0x58, 2, 0]


def test_a_page_shows_and_sets_what_points_mean(device: Device) -> None:
    points = device.points
    unit = ShownUnit(None, device)

    def texts() -> list[str]:
        return [row[0] for row in point_rows(unit, 0, 100, lambda *_: Samples()).values()]

    before = ["230.5", "-1", "on", "on", "5", "door=0 alarm=1", "- (Missing)"]
    assert texts() == before
    set_point(unit, points["mode"], "2")
    set_point(unit, points["state"], "off")
    set_point(unit, points["flags"], "door=1")
    assert texts() == ["230.5", "-1", "off", "on", "2", "door=1 alarm=1", "- (Missing)"]
    assert device.mapping.holding_registers[3] == 0x28
    set_point(unit, points["v_sf"], "0")
    assert texts()[:2] == ["2305", "0"]
    with pytest.raises(ValueError, match="value must be one of off, on, or a number, not 'up'"):
        set_point(unit, points["state"], "up")


def test_a_state_that_is_not_there_has_its_place(tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(MAP)
    (tmp_path / "device.toml").write_text(DEVICE.replace('"on"', '"up"'))
    with pytest.raises(DeviceFileError, match=r"line 8: .*state must be one of off, on, or a num"):
        load(tmp_path / "device.toml")


# --- ranges of device files whose registers have a meaning ----------------------------------------


RANGES = """
[[unit]]

[[unit.holding_registers]]
address = 0
name = "remote"
bit = 3
value = true

[[unit.holding_registers]]
address = 0
name = "mode"
bit = "4..7"
maximum = 9
value = 5

[[unit.holding_registers]]
address = 1
name = "state"
states = { 0 = "off", 1 = "on" }
value = "on"

[[unit.holding_registers]]
address = 2
name = "power"
type = "int16"
scale_from = "power_sf"
missing = "sunspec"
value = 1250

[[unit.holding_registers]]
address = 3
name = "power_sf"
type = "int16"
value = 1

[[unit.holding_registers]]
address = 4
name = "clock"
type = "date48"
time_zone = "Europe/Berlin"
value = 2024-07-15T10:00:00Z

[[unit.holding_registers]]
address = 7
name = "faults"
bits = { 0 = "door", "4..7" = "code" }
value = { door = true, code = 3 }
"""


def device_of(text: str) -> SimulatedDevice:
    device = parse(text).devices
    assert isinstance(device, SimulatedDevice)
    return device


def test_ranges_hold_what_their_values_mean() -> None:
    device = device_of(RANGES)
    assert list(device.mapping.holding_registers[0:8]) == [
        5 << 4 | 1 << 3, 1, 125, 1, 24 << 8 | 7, 15 << 8 | 12, 0, 0x31,
    ]  # fmt: skip
    assert {name: device[name] for name in device.points} == {
        "remote": True,
        "mode": 5,
        "state": "on",
        "power": 1250,
        "power_sf": 1,
        "clock": datetime(2024, 7, 15, 10, tzinfo=UTC),
        "faults": {"door": True, "code": 3},
    }


def test_bits_of_one_register_are_set_by_themselves() -> None:
    device = device_of(RANGES)
    device.update({"mode": 9})
    assert (device["remote"], device["mode"]) == (True, 9)
    with pytest.raises(ValueError, match=r"mode: value must be in \.\.9, not 10"):
        device["mode"] = 10
