"""
Bounds of points that another register scales, at servers: with the scale as it is after a write.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from libmodbus_py import Device, Point, RegisterMap, pdu
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


# Request -> the code of the exception, 0 for none. The scale is 0.1, the factor 2.
REQUESTS: list[tuple[pdu.Request[Any], int]] = [
    (pdu.WriteRegister(0, 50), 0),
    (pdu.WriteRegister(0, 300), 0),
    (pdu.WriteRegister(0, 49), 3),
    (pdu.WriteRegister(0, 301), 3),
    (pdu.MaskWriteRegister(0, 0, 301), 3),
    (pdu.WriteRegisters(0, [30, 0]), 0),  # 30 at a scale of 1
    (pdu.WriteRegisters(0, [300, 0]), 3),  # 300
    (pdu.WriteRegisters(0, [3, 1]), 3),  # 30 at a scale of 10, but the limit would be 800
    (pdu.WriteRegisters(0, [3, 1, 0]), 0),
    (pdu.WriteRegisters(0, [20, 0x8000]), 3),  # a scale that means none
    (pdu.WriteRegisters(0, [20, 300]), 3),  # 10 to the power of 300
    (pdu.WriteRegister(1, 0), 3),  # the scale alone: the setpoint would be 200
    (pdu.WriteRegister(2, 50), 0),
    (pdu.WriteRegister(2, 51), 3),
    (pdu.WriteRegisters(2, [51, 10]), 0),  # a factor of 1
    (pdu.WriteRegisters(0, [20, 0, 5]), 0),  # 5 times 20
    (pdu.WriteRegisters(0, [20, 0, 6]), 3),
    (pdu.WriteRegisters(1, [0, 5]), 3),
    (pdu.ReadWriteRegisters(0, 1, 0, [301]), 3),
]


@each_case(("request_", "code"), REQUESTS)
def test_a_write_is_checked_with_the_scale_after_it(
    make: Callable[[], Device], request_: pdu.Request[Any], code: int
) -> None:
    device = make()
    before = list(device.mapping.holding_registers[0:4])
    answer = device.answer(request_.encode())
    assert answer is not None
    assert (answer[1] if answer[0] & 0x80 else 0) == code
    assert not code or list(device.mapping.holding_registers[0:4]) == before
