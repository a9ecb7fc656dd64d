"""
Ranges of device files whose registers have a meaning: bits, states, scales of other ranges, times.
"""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

from libmodbus_py.tools.simulator.device_file import parse
from libmodbus_py.tools.simulator.simulated import SimulatedDevice

DEVICE = """
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
    device = device_of(DEVICE)
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
    device = device_of(DEVICE)
    device.update({"mode": 9})
    assert (device["remote"], device["mode"]) == (True, 9)
    with pytest.raises(ValueError, match=r"mode: value must be in \.\.9, not 10"):
        device["mode"] = 10
