"""
Values that are copies of others.
"""

from __future__ import annotations

from itertools import pairwise

import pytest

from libmodbus_py import ServerDeviceFailure, pdu, values
from tests.support.cases import each_case
from tests.tools.simulator.simulated_units import Clock, answer, holding, inputs, unit


def test_copies_of_2000_copies_are_made_at_once() -> None:
    """Each finds its sources run by run, and copies them together."""
    tables = ["coils", "discrete_inputs", "holding_registers", "input_registers"]
    text = "".join(
        f"[[unit.{table}]]\naddress = 0\ncount = 2000\n"
        f"copy = {{ table = '{other}', address = 0 }}\n"
        for table, other in pairwise(tables)
    )
    device = unit(text + "[[unit.input_registers]]\naddress = 0\ncount = 2000")
    device.mapping.input_registers[0:2000] = [at % 3 == 0 for at in range(2000)]
    assert answer(device, pdu.ReadCoils(0, 2000)) == [at % 3 == 0 for at in range(2000)]


def test_copies_go_on_from_run_to_run() -> None:
    """In the rhythm of the first; a longer value behind it is not hit in its middle."""
    device = unit("""
        [[unit.holding_registers]]
        address = 0
        count = 6
        copy = { table = "input_registers", address = 10 }
        [[unit.coils]]
        address = 0
        count = 3
        copy = { table = "holding_registers", address = 1 }
        [[unit.input_registers]]
        address = 10
        type = "uint32"
        values = [1, 70000]
        [[unit.input_registers]]
        address = 14
        values = [3, 99, 4, 99]
        [[unit.input_registers]]
        address = 18
        type = "uint32"
        values = [5, 6]
    """)
    assert holding(device, 0, 6) == [1, 65535, 3, 4, 5, 6]
    assert holding(device, 3, 2) == [4, 5]
    assert answer(device, pdu.ReadCoils(0, 3)) == [True, True, True]


COPIES = """
    [[unit.holding_registers]]
    address = 0
    type = "{source}"
    count = 2
    value = {value}
    [[unit.input_registers]]
    address = 7
    type = "{target}"
    count = 2
    copy = {{ table = "holding_registers", address = 0, scale = {scale} }}
"""


@each_case(
    ("source", "value", "target", "scale", "expected"),
    [
        ("uint16", 555, "uint16", 1, 555),
        ("float32", 21.56, "int16", 10, 216),
        ("float32", 21.5, "float64", -2, -43.0),
        ("int16", -5, "uint16", 1, 0),
        ("uint32", 70000, "uint16", 1, 65535),
        ("uint16", 70, "bcd16", 1000, 9999),
        ("float64", 1e300, "float32", 1, values.value_type("float32").decode([0x7F7F, 0xFFFF])),
        ("float64", 1e300, "float16", -1, -65504.0),
        ("float64", "nan", "int16", 1, 0),
        ("float64", "inf", "int16", -1, -32768),
        ("uint64", (1 << 64) - 1, "uint64", 1, (1 << 64) - 1),
        ("string:4", '"abc"', "string:4", 1, "abc"),
        ("bits16", [1] + [0] * 15, "bits16", 1, [True] + [False] * 15),
    ],
)
def test_copies(source: str, value: object, target: str, scale: float, expected: object) -> None:
    device = unit(COPIES.format(source=source, value=value, target=target, scale=scale))
    count = 2 * values.value_type(target).registers
    assert values.value_type(target).decode_many(inputs(device, 7, count)) == [expected, expected]


def test_a_copy_follows_what_clients_write() -> None:
    device = unit(COPIES.format(source="uint16", value=0, target="uint16", scale=2))
    answer(device, pdu.WriteRegisters(0, (5, 6)))
    assert inputs(device, 7, 2) == [10, 12]
    assert inputs(device, 8) == [12]


def test_a_copy_of_what_is_no_value_is_exception_4() -> None:
    device = unit(COPIES.format(source="bcd16", value=1, target="uint16", scale=1))
    answer(device, pdu.WriteRegister(0, 0xABCD))
    with pytest.raises(ServerDeviceFailure):
        inputs(device, 7)
    assert inputs(device, 8) == [1]


def test_a_copy_of_a_copy_is_of_now() -> None:
    clock = Clock()
    device = unit(
        """
        [[unit.holding_registers]]
        address = 9
        counter = {}
        [[unit.holding_registers]]
        address = 1
        count = 8
        copy = { table = "holding_registers", address = 2, scale = 2 }
    """,
        clock,
    )
    clock.now += 3
    assert holding(device, 1) == [3 << 8]
    assert holding(device, 8, 2) == [6, 3]
