"""
Writes of a value that scales other points, which must not leave their bounds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py import Device, Mapping, Point, RegisterMap, pdu
from libmodbus_py.tools.faults.server import Server
from libmodbus_py.tools.page.setting import set_cells, set_point
from libmodbus_py.tools.page.shown import ShownUnit, shown_of
from libmodbus_py.tools.simulator.device_file import parse
from tests.device.scaled import file_of
from tests.support.cases import each_case

H = "holding_registers"

MAP = RegisterMap(
    [
        Point("sf", H, 0, type="int16", missing="sunspec"),
        Point("factor", H, 9, scale=0.1, scale_from="sf"),
        Point("setpoint", H, 20, type="int16", scale_from="sf", minimum=5, maximum=30),
        Point("limit", "input_registers", 0, scale_from="factor", scale_as="factor", maximum=100),
        Point("free", H, 30, scale_from="sf"),
    ]
)

VALUES = {"sf": -1, "setpoint": 20, "factor": 0.5, "limit": 10, "free": 2}


def cells(device: Device) -> list[list[int]]:
    mapping = device.mapping
    return [
        [*table[each.start : each.stop]]
        for table in (mapping.holding_registers, mapping.input_registers)
        for each in table.ranges
    ]


def written(device: Device, request: pdu.Request[Any]) -> int:
    """Return the code of the exception that a client gets; 0 without one."""
    answer = device.answer(request.encode())
    return answer[1] if answer[0] & 0x80 else 0


# The scale is 0.1, the setpoint 20, the factor 0.5 and the limit 10: a scale of 1 makes the
# setpoint 200, and a factor of 6 the limit 120.
CHANGES: list[tuple[str, dict[str, Any], list[tuple[int, int]]]] = [
    ("setpoint: sf scales it, and .* 5..30, not 200", {"sf": 0}, [(0, 0)]),
    ("setpoint: sf scales it, and .* 5..30, not 2", {"sf": -2}, [(0, 0xFFFE)]),
    ("setpoint: sf scales it, and .*must hold", {"sf": 31}, [(0, 31)]),
    ("limit: factor scales it, and .* ..100, not 120", {"factor": 6}, [(9, 600)]),
    ("", {"factor": 5}, [(9, 500)]),
    ("", {"sf": -1}, [(0, 0xFFFF)]),
]


@each_case(("message", "values", "registers"), CHANGES)
def test_a_point_stays_within_its_bounds_whoever_writes_its_scale(
    make: Callable[[], Device],
    message: str,
    values: dict[str, Any],
    registers: list[tuple[int, int]],
) -> None:
    first = cells(make())
    device = make()
    ((address, register),) = registers
    requests = [
        pdu.WriteRegister(address, register),
        pdu.WriteRegisters(address, [register]),
        pdu.MaskWriteRegister(address, 0, register),
        pdu.ReadWriteRegisters(address, 1, address, [register]),
    ]
    for request in requests:
        device = make()
        assert written(device, request) == (3 if message else 0)
        assert not message or cells(device) == first
    ((name, value),) = values.items()
    for write in (by_update, by_item, on_page):
        device = make()
        if not message:
            write(device, name, value)
            continue
        with pytest.raises(ValueError, match=message):
            write(device, name, value)
        assert cells(device) == first


def by_update(device: Device, name: str, value: Any) -> None:
    device.update({name: value})


def by_item(device: Device, name: str, value: Any) -> None:
    device[name] = value


def on_page(device: Device, name: str, value: Any) -> None:
    set_point(unit_of(device), device.points[name], str(value))


def unit_of(device: Device) -> ShownUnit:
    return shown_of(Server(device)).units[None]


def test_scale_and_value_may_be_written_together(make: Callable[[], Device]) -> None:
    device = make()
    device.update({"sf": 0, "setpoint": 30, "factor": 0.5})
    assert (device["sf"], device["setpoint"], device["limit"]) == (0, 30, 10)


def test_a_client_may_write_both_in_one_request() -> None:
    points = [Point("sf", H, 1, type="int16"), Point("power", H, 0, scale_from="sf", maximum=99)]
    device = Device.of_map(RegisterMap(points), {"power": 90})
    assert written(device, pdu.WriteRegister(1, 1)) == 3
    assert written(device, pdu.WriteRegisters(0, [9, 1])) == 0
    assert device["power"] == 90


@pytest.mark.parametrize("first", [{}, {"sf": None}])
def test_what_is_outside_already_may_stay_outside(first: dict[str, Any]) -> None:
    """A device without values could not be set up otherwise."""
    device = Device.of_map(MAP)
    if first:
        device.mapping.holding_registers[0] = 0x8000  # "not implemented"
    assert written(device, pdu.WriteRegister(20, 200)) == 3
    assert written(device, pdu.WriteRegister(0, 0xFFFF)) == 0
    assert written(device, pdu.WriteRegister(20, 200)) == 0
    assert device["setpoint"] == 20
    other = Device.of_map(MAP)
    for name, value in VALUES.items():
        other[name] = value
    assert cells(other) == cells(Device.of_map(MAP, VALUES))


def test_values_are_scaled_by_what_the_cells_of_their_scale_hold() -> None:
    """0.26 is held as 0.3."""
    points = [Point("factor", H, 1, scale=0.1), Point("a", H, 0, scale_from="factor")]
    points[1] = Point("a", H, 0, scale_from="factor", scale_as="factor", maximum=31)
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
    with pytest.raises(ValueError, match="power: exponent scales it"):
        device.update({"code": 7, "exponent": 1})
    assert written(device, pdu.MaskWriteRegister(0, 0xFF00, 1)) == 3
    device.update({"code": 7, "exponent": 1, "power": 40})
    assert device.mapping.holding_registers[0:2] == [0x0701, 4]
    assert written(device, pdu.WriteRegister(0, 0x0601)) == 0


def test_registers_without_a_name_are_set_as_they_are() -> None:
    """The mapping itself, and raw registers on a page, know no bounds."""
    device = Device.of_map(MAP, VALUES)
    set_cells(unit_of(device), H, 0, "0", "int16", "ABCD")
    assert device["setpoint"] == 200
    mapping = Mapping(holding_registers=range(31), input_registers=range(1))
    device = Device(mapping, points=MAP)
    mapping.holding_registers[20] = 200
    assert device["setpoint"] == 200


def test_a_moving_scale_is_computed_before_it_is_used() -> None:
    text = (
        file_of(MAP, VALUES)
        .replace(
            'missing = "sunspec"\nvalue = -1',
            "counter = { step = 1, interval = 9999, start = 1, wrap = 5 }",
        )
        .replace("minimum = 5\nmaximum = 30\nvalue = 20\n", "")
    )
    device = parse(text.replace("value = 0.5", "").replace("value = 10", "")).devices
    assert isinstance(device, Device)
    device["setpoint"] = 20
    assert device.mapping.holding_registers[20] == 2
    assert device["setpoint"] == 20
