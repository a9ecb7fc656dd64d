"""
Which requests the ranges of a device file allow.
"""

from __future__ import annotations

from typing import Any

import pytest

from libmodbus_py import IllegalDataAddress, pdu
from tests.support.cases import each_case
from tests.tools.simulator.simulated_units import answer, unit

ACCESS = """
    [[unit.holding_registers]]
    address = 0
    count = 2
    [[unit.holding_registers]]
    address = 2
    count = 2
    access = "read"
    [[unit.holding_registers]]
    address = 4
    count = 2
    access = "write"
    [[unit.holding_registers]]
    address = 8
    count = 2
    access = "read_write"
    [[unit.coils]]
    address = 0
    count = 2
    [[unit.coils]]
    address = 2
    access = "read"
    [[unit.coils]]
    address = 3
    access = "write"
    [[unit.file]]
    number = 1
    record = 0
    count = 2
    [[unit.file]]
    number = 1
    record = 2
    access = "read"
    [[unit.file]]
    number = 1
    record = 3
    access = "write"
    [[unit.file]]
    number = 1
    record = 6
    [[unit.file]]
    number = 2
    record = 3
"""

# Request -> whether it is executed; neighbours that allow the same are one range.
REQUESTS = [
    (pdu.ReadHoldingRegisters(0, 4), True),
    (pdu.ReadHoldingRegisters(0, 5), False),
    (pdu.ReadHoldingRegisters(3, 2), False),
    (pdu.ReadHoldingRegisters(4, 1), False),
    (pdu.ReadHoldingRegisters(6, 1), False),
    (pdu.ReadHoldingRegisters(6, 2), False),
    (pdu.ReadHoldingRegisters(7, 2), False),
    (pdu.ReadHoldingRegisters(8, 2), True),
    (pdu.ReadHoldingRegisters(9, 2), False),
    (pdu.WriteRegister(1, 9), True),
    (pdu.WriteRegister(2, 9), False),
    (pdu.WriteRegister(4, 9), True),
    (pdu.WriteRegister(6, 9), False),
    (pdu.WriteRegisters(0, (9, 9)), True),
    (pdu.WriteRegisters(1, (9, 9)), False),
    (pdu.WriteRegisters(4, (9, 9)), True),
    (pdu.WriteRegisters(5, (9, 9)), False),
    (pdu.MaskWriteRegister(0, 0, 0), True),
    (pdu.MaskWriteRegister(3, 0, 0), False),
    (pdu.ReadWriteRegisters(0, 4, 4, (9, 9)), True),
    (pdu.ReadWriteRegisters(4, 1, 0, (9, 9)), False),
    (pdu.ReadWriteRegisters(0, 1, 2, (9,)), False),
    (pdu.ReadCoils(0, 3), True),
    (pdu.ReadCoils(2, 2), False),
    (pdu.WriteCoil(3, True), True),
    (pdu.WriteCoil(2, True), False),
    (pdu.WriteCoils(0, (True, True)), True),
    (pdu.WriteCoils(1, (True, True)), False),
    (pdu.ReadFileRecords(((1, 0, 3),)), True),
    (pdu.ReadFileRecords(((1, 2, 2),)), False),
    (pdu.ReadFileRecords(((1, 4, 1),)), False),
    (pdu.ReadFileRecords(((1, 6, 1), (2, 3, 1))), True),
    (pdu.ReadFileRecords(((2, 0, 1),)), False),
    (pdu.ReadFileRecords(((3, 0, 1),)), False),
    (pdu.WriteFileRecords(((1, 0, (9, 9)),)), True),
    (pdu.WriteFileRecords(((1, 3, (9,)),)), True),
    (pdu.WriteFileRecords(((1, 0, (9,)), (1, 2, (9,)))), False),
]


@each_case(("request_", "is_executed"), REQUESTS, ids=str)
def test_what_a_range_does_not_allow_is_exception_2(
    request_: pdu.Request[Any], is_executed: bool
) -> None:
    device = unit(ACCESS)
    tables = device.mapping.holding_registers, device.mapping.coils, *device.files.values()
    before = [list(table) for table in tables]
    if is_executed:
        answer(device, request_)
    else:
        with pytest.raises(IllegalDataAddress):
            answer(device, request_)
    # A mask write of 0 and 0 leaves the 0 that is there.
    writes = hasattr(request_, "values") or hasattr(request_, "value") or bool(_pieces(request_))
    assert ([list(table) for table in tables] != before) is (is_executed and writes)


def _pieces(request: pdu.Request[Any]) -> list[Any]:
    return list(request.records) if isinstance(request, pdu.WriteFileRecords) else []
