"""
Device files: values lie where the file says, with the types that it says; units and their faults.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from libmodbus_py import Context, ExceptionResponse, IllegalDataAddress, Server, pdu
from libmodbus_py.tools.faults.fault import Fault
from libmodbus_py.tools.simulator.device_file import load, parse
from tests.support.cases import each_case
from tests.tools.simulator.simulated_units import HOLDING, answer, holding, inputs, unit


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


def test_a_file_may_come_through_a_pipe() -> None:
    """As in ``--device <(program)``."""
    reading, writing = os.pipe()
    try:
        with open(writing, "w") as pipe:
            pipe.write(HOLDING + "value = 42")
        devices = load(f"/dev/fd/{reading}").devices
    finally:
        os.close(reading)
    assert not isinstance(devices, dict)
    assert holding(devices, 0) == [42]


# --- units and faults ------------------------------------------------------------------------


def test_units_are_told_apart_and_faults_are_collected() -> None:
    devices, faults = parse("""
        [[fault]]
        kind = "no_answer"
        every = 9
        [[unit]]
        id = 247
        exception_status = 1
        [[unit.fault]]
        kind = "delay"
        seconds = 2
        [[unit]]
        id = 0
        exception_status = 2
    """)
    assert isinstance(devices, dict)
    assert {number: device.exception_status for number, device in devices.items()} == {247: 1, 0: 2}
    assert faults == {None: [Fault("no_answer", every=9)], 247: [Fault("delay", seconds=2)]}


def test_the_faults_of_a_unit_without_id_are_for_every_unit() -> None:
    _, faults = parse("""
        [[unit]]
        [[unit.fault]]
        kind = "no_answer"
        [[fault]]
        kind = "wrong_unit"
    """)
    assert faults == {None: [Fault("wrong_unit"), Fault("no_answer")]}


def test_every_unit_of_a_file_without_id_is_served(tmp_path: Path) -> None:
    path = tmp_path / "device.toml"
    path.write_text(HOLDING + "value = 42\n[[unit.fault]]\nkind='exception'\ncode=3\nfunction=1\n")
    with Server(*load(path)).background("tcp://127.0.0.1:0") as running:
        for number in (0, 1, 255):
            with Context.from_url(running.urls[0], unit=number) as client:
                assert client.read_holding_registers(0, 1) == [42]
                with pytest.raises(ExceptionResponse, match="exception 3"):
                    client.read_coils(0, 1)
