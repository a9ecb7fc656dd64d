"""
Device files: values lie where the file says, with the types that it says.
"""

from __future__ import annotations

import pytest

from libmodbus_py import IllegalDataAddress, pdu
from tests.support.cases import each_case
from tests.tools.simulator.simulated_units import answer, holding, inputs, unit


def test_values_lie_where_the_file_says() -> None:
    device = unit("""
        [[unit.holding_registers]]
        address = 65535
        value = 7
        [[unit.holding_registers]]
        address = 0
        values = [1, 2]
        [[unit.input_registers]]
        address = 10
        count = 3
        value = 9
        [[unit.coils]]
        address = 5
        values = [true, 0, 1, false]
        [[unit.discrete_inputs]]
        address = 5
        count = 2
        value = true
    """)
    assert holding(device, 65535) == [7]
    assert holding(device, 0, 2) == [1, 2]
    assert inputs(device, 10, 3) == [9, 9, 9]
    assert answer(device, pdu.ReadCoils(5, 4)) == [True, False, True, False]
    assert answer(device, pdu.ReadDiscreteInputs(5, 2)) == [True, True]


@each_case(
    ("content", "registers"),
    [
        ("count = 3", [0, 0, 0]),
        ('type = "int16"\nvalue = -2', [0xFFFE]),
        ('type = "float32"\nvalue = 3', [0x4040, 0]),
        ('type = "float32"\norder = "CDAB"\nvalues = [-1.5]', [0, 0xBFC0]),
        ('type = "uint32"\norder = "DCBA"\nvalue = 0x12345678', [0x7856, 0x3412]),
        ('type = "bcd16"\ncount = 2\nvalue = 1234', [0x1234, 0x1234]),
        ('type = "uint64"\nvalue = 0x0102030405060708', [0x0102, 0x0304, 0x0506, 0x0708]),
        ('type = "string:5"\nvalue = "abc"\npadding = " "', [0x6162, 0x6320, 0x2000]),
        ('type = "string:4"\nvalue = "°C"\nencoding = "latin-1"', [0xB043, 0]),
        ('type = "string:4"\npadding = " "', [0x2020, 0x2020]),
        ('type = "float16"', [0]),
        ('type = "bits16"', [0]),
        (f'type = "bits16"\nvalue = {[1, *[0] * 14, 1]}', [0x8001]),
    ],
)
def test_types_are_those_of_values(content: str, registers: list[int]) -> None:
    device = unit(f"[[unit.holding_registers]]\naddress = 3\n{content}")
    assert holding(device, 3, len(registers)) == registers
    with pytest.raises(IllegalDataAddress):
        holding(device, 3, len(registers) + 1)


def test_a_table_without_ranges_does_not_exist() -> None:
    device = unit("exception_status = 3")
    for request in (
        pdu.ReadCoils(0, 1),
        pdu.ReadInputRegisters(0, 1),
        pdu.WriteRegister(0, 1),
        pdu.ReadFileRecords(((1, 0, 1),)),
        pdu.ReadFifoQueue(0),
    ):
        with pytest.raises(IllegalDataAddress):
            answer(device, request)
    assert answer(device, pdu.ReadExceptionStatus()) == 3
