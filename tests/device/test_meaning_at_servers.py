"""What points mean at servers: scales of other registers, values set together, no value."""

from typing import Any

import pytest

from libmodbus_py import Device, IllegalDataValue, NoValue, Point, RegisterMap, pdu
from libmodbus_py.tools.simulator.device_file import parse
from tests.support.cases import each_case

H = "holding_registers"

MAP = RegisterMap(
    [
        Point("setpoint", H, 0, type="int16", scale_from="sf", minimum=5, maximum=30),
        Point("sf", H, 1, type="int16", missing="sunspec"),
        Point("limit", H, 2, scale_from="factor", scale_as="factor", maximum=100),
        Point("factor", H, 3, scale_from="sf"),
    ]
)

VALUES = {"sf": -1, "setpoint": 20, "factor": 2, "limit": 8}

FILE = """
[[unit]]
holding_registers = [
{address=0, name="setpoint", type="int16", scale_from="sf", minimum=5, maximum=30, value=20},
{address=1, name="sf", type="int16", missing="sunspec", value=-1},
{address=2, name="limit", scale_from="factor", scale_as="factor", maximum=100, value=8},
{address=3, name="factor", scale_from="sf", value=2},
]
"""


def new_device(origin: str) -> Device:
    if origin == "map":
        return Device.of_map(MAP, VALUES)
    device = parse(FILE).devices
    assert isinstance(device, Device)
    return device


def written(device: Device, request: pdu.Request[Any]) -> int:
    """Return the code of the exception that a client gets; 0 without one."""
    answer = device.answer(request.encode())
    return answer[1] if answer[0] & 0x80 else 0


# Request -> the code of the exception, 0 for none. The scale is 0.1, the factor 2.
REQUESTS: list[tuple[pdu.Request[Any], int]] = [
    (pdu.WriteRegister(0, 50), 0),
    (pdu.WriteRegister(0, 300), 0),
    (pdu.WriteRegister(0, 49), 3),
    (pdu.WriteRegister(0, 301), 3),
    (pdu.MaskWriteRegister(0, 0, 301), 3),
    (pdu.WriteRegisters(0, [30, 0]), 0),  # 30 at a scale of 1
    (pdu.WriteRegisters(0, [300, 0]), 3),  # 300
    (pdu.WriteRegisters(0, [3, 1]), 0),  # 30 at a scale of 10
    (pdu.WriteRegisters(0, [3, 1, 0]), 0),
    (pdu.WriteRegisters(0, [3, 1, 1]), 3),  # the limit is the factor, 200
    (pdu.WriteRegisters(0, [20, 0x8000]), 3),  # a scale without a valid value
    (pdu.WriteRegisters(0, [20, 300]), 3),  # 10 to the power of 300
    (pdu.WriteRegister(2, 50), 0),
    (pdu.WriteRegister(2, 51), 3),
    (pdu.WriteRegisters(2, [51, 10]), 0),  # a factor of 1
    (pdu.WriteRegisters(0, [20, 0, 6]), 3),
    (pdu.WriteRegisters(1, [0, 6]), 3),
    (pdu.ReadWriteRegisters(0, 1, 0, [301]), 3),
    (pdu.WriteRegister(1, 0), 0),  # a scale alone: the points that it scales are not checked
    (pdu.WriteRegister(1, 0x8000), 0),
    (pdu.WriteRegister(3, 65535), 0),
]


@each_case("origin", ["map", "file"])
@each_case(("request_", "code"), REQUESTS)
def test_a_write_is_checked_with_the_scale_after_it(origin, request_, code) -> None:
    device = new_device(origin)
    before = list(device.mapping.holding_registers[0:4])
    assert written(device, request_) == code
    assert not code or list(device.mapping.holding_registers[0:4]) == before


@each_case("origin", ["map", "file"])
def test_scale_and_value_may_be_set_together(origin: str) -> None:
    device = new_device(origin)
    device.update({"sf": 0, "setpoint": 30, "factor": 3})
    assert (device["sf"], device["setpoint"], device["limit"]) == (0, 30, 12)
    with pytest.raises(ValueError, match=r"setpoint: value must be in 5..30, not 31"):
        device.update({"sf": -1, "setpoint": 31})
    assert (device["sf"], device["setpoint"]) == (0, 30)


def test_a_scale_may_be_set_alone() -> None:
    device = new_device("map")
    device["sf"] = 0
    assert device["setpoint"] == 200


def test_values_are_scaled_by_what_the_cells_of_their_scale_hold() -> None:
    """0.26 is held as 0.3."""
    points = [
        Point("factor", H, 1, scale=0.1),
        Point("a", H, 0, scale_from="factor", scale_as="factor", maximum=31),
    ]
    device = Device.of_map(RegisterMap(points), {"a": 30, "factor": 0.26})
    assert device["factor"] == 0.3
    assert device["a"] == 30
    with pytest.raises(ValueError, match="a: value must be in"):
        device.update({"a": 31.1, "factor": 0.26})


def test_a_scale_may_be_a_part_of_a_register() -> None:
    points = [
        Point("code", H, 0, byte="high"),
        Point("exponent", H, 0, byte="low"),
        Point("power", H, 1, scale_from="exponent", maximum=99),
    ]
    device = Device.of_map(RegisterMap(points), {"power": 90})
    device.update({"code": 7, "exponent": 1, "power": 40})
    assert device.mapping.holding_registers[0:2] == [0x0701, 4]
    assert written(device, pdu.WriteRegister(1, 10)) == 3
    assert written(device, pdu.WriteRegister(1, 9)) == 0


def test_a_long_chain_of_scales() -> None:
    links = [Point(f"s{at}", H, at, scale_from=f"s{at + 1}") for at in range(2000)]
    points = RegisterMap([*links, Point("s2000", H, 2000)])
    device = Device.of_map(points)
    device["s0"] = 7
    assert device["s0"] == 7


def test_a_moving_scale_is_computed_before_a_value_is_scaled() -> None:
    counter = "counter = { step = 1, interval = 9999, start = 1, wrap = 5 }"
    text = FILE.replace('missing="sunspec", value=-1', counter)
    for plain in (", minimum=5, maximum=30, value=20", ", value=8", ", value=2"):
        text = text.replace(plain, "")
    device = parse(text).devices
    assert isinstance(device, Device)
    device["setpoint"] = 20
    assert device.mapping.holding_registers[0] == 2
    assert device["setpoint"] == 20


POINTS = RegisterMap(
    [
        Point("state", H, 0, states={0: "off", 1: "on"}),
        Point("flag", H, 1, bit=3),
        Point("mode", H, 1, bit="4..7"),
        Point("v", H, 2, type="int16", scale_from="v_sf", missing="sunspec"),
        Point("v_sf", H, 3, type="int16", missing="sunspec"),
        Point("level", H, 4, missing=0xFFFF, minimum=0, maximum=10),
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
