"""
Values of simulated devices by name, and the bounds that they hold clients to.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from libmodbus_py import device_file
from libmodbus_py.device_file import SimulatedDevice
from tests.tools.simulator.simulated_units import Clock

MAP = """\
name,table,address,type,scale,access,minimum,maximum
setpoint,holding,0,uint16,0.1,read_write,5,30
total,holding,1,uint32,1,read_write,,70000
total_low,holding,2,uint16,1,read_write,,
power,input,0,int16,1,read,,
limit,holding,9,uint16,1,read_write,,10
"""

DEVICE = """\
[[unit]]
map = "map.csv"
[unit.values]
setpoint = 20
[unit.moves]
power = { counter = { start = 5, interval = 1 } }
[[unit.holding_registers]]
address = 20
maximum = 100
name = "own"
[[unit.holding_registers]]
address = 21
counter = { interval = 1 }
name = "ticks"
"""


def simulated(folder: Path, clock: Clock) -> SimulatedDevice:
    (folder / "map.csv").write_text(MAP)
    (folder / "device.toml").write_text(DEVICE)
    devices = device_file.load(folder / "device.toml", clock=clock).devices
    assert isinstance(devices, SimulatedDevice)
    return devices


def test_bounds_of_maps_and_ranges(tmp_path: Path) -> None:
    device = simulated(tmp_path, Clock())
    assert device.answer(b"\6\0\0\0\x31") == b"\x86\3"
    assert device.answer(b"\6\0\0\0\x32") == b"\6\0\0\0\x32"
    assert device["setpoint"] == 5
    assert device.answer(b"\6\0\x14\0\x65") == b"\x86\3"
    assert device.answer(b"\6\0\x14\0\x64")[0] == 6
    assert device["own"] == 100
    assert device.answer(b"\6\0\x15\0\0") == b"\x86\2"


def test_bounds_of_points_that_share_cells(tmp_path: Path) -> None:
    device = simulated(tmp_path, Clock())
    assert device.answer(b"\6\0\1\0\1")[0] == 6
    assert device.answer(b"\6\0\2\x11\x71") == b"\x86\3"
    assert device.answer(b"\6\0\2\x11\x70")[0] == 6
    assert (device["total"], device["total_low"]) == (70_000, 4464)


def test_moving_values_by_name(tmp_path: Path) -> None:
    clock = Clock()
    device = simulated(tmp_path, clock)
    clock.now += 7
    assert (device["power"], device["ticks"]) == (12, 7)
    for name in ("power", "ticks"):
        with pytest.raises(ValueError, match=f"{name}: the device computes this value itself"):
            device.update({"setpoint": 30, name: 3})
    assert device["setpoint"] == 20
    device.update({"setpoint": 30, "own": 3})
    assert (device["setpoint"], device["own"]) == (30, 3)
    with pytest.raises(KeyError, match="no point 'setpiont'; did you mean setpoint"):
        device["setpiont"] = 3
    with pytest.raises(KeyError, match="no point 'setpiont'"):
        device["setpiont"]
