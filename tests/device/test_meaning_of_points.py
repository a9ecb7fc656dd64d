"""
Devices set and return what points mean: states, parts of registers, scales, no value.
"""

from __future__ import annotations

from typing import Any

import pytest

from libmodbus_py import Device, IllegalDataValue, NoValue, Point, RegisterMap, pdu

H = "holding_registers"


def point(name: str, address: int, **keys: Any) -> Point:
    return Point(name, H, address, **keys)


POINTS = RegisterMap(
    [
        point("state", 0, states={0: "off", 1: "on"}),
        point("flag", 1, bit=3),
        point("mode", 1, bit="4..7"),
        point("v", 2, type="int16", scale_from="v_sf", missing="sunspec"),
        point("v_sf", 3, type="int16", missing="sunspec"),
        point("level", 4, missing=0xFFFF, minimum=0, maximum=10),
    ]
)


def test_values_are_set_and_returned_by_what_they_mean() -> None:
    device = Device.of_map(POINTS, {"state": "on", "v": 230.5, "v_sf": -1, "level": 5})
    assert device.mapping.holding_registers[0:5] == [1, 0, 2305, 0xFFFF, 5]
    device.mapping.holding_registers[1] = 0xFF0F
    device.update({"mode": 5, "flag": False})
    assert device.mapping.holding_registers[1] == 0xFF57
    assert {name: device[name] for name in POINTS} == {
        "state": "on", "flag": False, "mode": 5, "v": 230.5, "v_sf": -1, "level": 5,
    }  # fmt: skip


def test_a_value_without_a_scale_is_none_and_is_not_set() -> None:
    device = Device.of_map(POINTS, {"state": 1})
    device.mapping.holding_registers[3] = 0x8000
    assert device["v"] is None
    with pytest.raises(NoValue, match="v_sf, which scales it, must hold a number"):
        device.update({"state": 0, "v": 1})
    assert device["state"] == "on"


def test_a_client_cannot_write_none_to_a_point_with_bounds() -> None:
    device = Device.of_map(POINTS, {"level": 5})
    answer = device.answer(pdu.WriteRegister(4, 0xFFFF).encode())
    assert answer == bytes([0x86, IllegalDataValue.code])
    assert device["level"] == 5
