"""Device files: addresses and types of values, units and their faults."""

from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Client, ExceptionResponse, IllegalDataAddress, Server, pdu
from libmodbus_py.serve import Caller
from libmodbus_py.tools.faults.fault import Fault
from libmodbus_py.tools.simulator.device_file import load, parse
from tests.support.cases import each_case
from tests.tools.simulator.simulated_units import answer, holding, inputs, unit


def test_values_are_at_the_addresses_of_the_file() -> None:
    device = unit("""
        holding_registers = [{ address = 65535, value = 7 }, { address = 0, values = [1, 2] }]
        input_registers = [{ address = 10, count = 3, value = 9 }]
        coils = [{ address = 5, values = [true, 0, 1, false] }]
        discrete_inputs = [{ address = 5, count = 2, value = true }]
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
        ('type = "float32"\norder = "CDAB"\nvalues = [-1.5]', [0, 0xBFC0]),
        ('type = "string:5"\nvalue = "abc"\npadding = " "', [0x6162, 0x6320, 0x2000]),
        ('type = "string:4"\npadding = " "', [0x2020, 0x2020]),
        ('type = "float16"', [0]),
        ('type = "bits16"', [0]),
        (f'type = "bits16"\nvalue = {[1, *[0] * 14, 1]}', [0x8001]),
        # Values are those that users see.
        ("scale = 0.1\nvalues = [230.5, 0.04, 0.06]", [2305, 0, 1]),
        ("scale = 0.1\noffset = -20\nvalue = -20", [0]),
        ("offset = 100", [0]),
        ("type = 'int32'\nscale = 0.001\nvalue = -0.001", [0xFFFF, 0xFFFF]),
    ],
)
def test_values_of_a_file_are_scaled_and_typed(content: str, registers: list[int]) -> None:
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


def test_each_unit_has_its_own_device_and_faults() -> None:
    simulation = parse("""
        fault = [{ kind = "no_answer", every = 9 }]
        [[unit]]
        id = 247
        exception_status = 1
        fault = [{ kind = "delay", seconds = 2 }]
        [[unit]]
        id = 0
        exception_status = 2
    """)
    devices, faults = simulation.devices, simulation.faults
    assert isinstance(devices, dict)
    assert {number: device.exception_status for number, device in devices.items()} == {247: 1, 0: 2}
    assert faults == {None: [Fault("no_answer", every=9)], 247: [Fault("delay", seconds=2)]}
    faults = parse(
        "fault = [{ kind = 'wrong_unit' }]\n[[unit]]\nfault = [{ kind = 'no_answer' }]"
    ).faults
    assert faults == {None: [Fault("wrong_unit"), Fault("no_answer")]}


def test_every_unit_of_a_file_without_id_is_served(tmp_path: Path) -> None:
    path = tmp_path / "device.toml"
    registers = "holding_registers = [{ address = 0, value = 42 }]"
    fault = "fault = [{ kind = 'exception', code = 3, function = 1 }]"
    path.write_text(f"[[unit]]\n{registers}\n{fault}\n")
    plant = load(path)
    with Server(plant.devices, faults=plant.faults).background("tcp://127.0.0.1:0") as running:
        for number in (0, 1, 255):
            with Client(running.urls[0], unit=number) as client:
                assert client.read_holding_registers(0, 1) == [42]
                with pytest.raises(ExceptionResponse, match="exception 3"):
                    client.read_coils(0, 1)


ACCESS = """
    holding_registers = [
        { address = 0, count = 2 },
        { address = 2, count = 2, access = "read" },
        { address = 4, count = 2, access = "write" },
        { address = 8, count = 2, access = "read_write" },
    ]
    coils = [{ address = 0, count = 2 }, { address = 2, access = "read" }, { address = 3, access = "write" }]
    file = [
        { number = 1, record = 0, count = 2 },
        { number = 1, record = 2, access = "read" },
        { number = 1, record = 3, access = "write" },
        { number = 1, record = 6 },
        { number = 2, record = 3 },
    ]
"""  # noqa: E501

# Request -> whether it is executed; neighbours that allow the same are one range. What else points
# in tables allow is in tests/device/test_point_rules.py.
REQUESTS = [
    (pdu.ReadHoldingRegisters(0, 4), True),
    (pdu.ReadHoldingRegisters(3, 2), False),
    (pdu.ReadHoldingRegisters(8, 2), True),
    (pdu.WriteRegister(2, 9), False),
    (pdu.WriteRegisters(4, (9, 9)), True),
    (pdu.ReadCoils(0, 3), True),
    (pdu.WriteCoils(1, (True, True)), False),
    (pdu.ReadFileRecords(((1, 0, 3),)), True),
    (pdu.ReadFileRecords(((1, 2, 2),)), False),
    (pdu.ReadFileRecords(((1, 4, 1),)), False),
    (pdu.ReadFileRecords(((1, 6, 1), (2, 3, 1))), True),
    (pdu.ReadFileRecords(((3, 0, 1),)), False),
    (pdu.WriteFileRecords(((1, 3, (9,)),)), True),
    (pdu.WriteFileRecords(((1, 0, (9,)), (1, 2, (9,)))), False),
]


@each_case(("request_", "is_executed"), REQUESTS, ids=str)
def test_a_write_outside_the_ranges_is_exception_2(request_, is_executed) -> None:
    device = unit(ACCESS)
    tables = device.mapping.holding_registers, device.mapping.coils, *device.files.values()
    before = [list(table) for table in tables]
    if is_executed:
        answer(device, request_)
    else:
        with pytest.raises(IllegalDataAddress):
            answer(device, request_)
    assert ([list(table) for table in tables] != before) is (is_executed and request_.changes)


UNITS = """
[[unit]]
id = 1
holding_registers = [{ address = 0, count = 100 }]
file = [{ number = 4, record = 0, count = 100 }]
fifo = [{ address = 5, values = [1] }]
[[unit]]
id = 2
holding_registers = [{ address = 0, count = 100 }]
[unit.roles.Engineer]
write = "all"
[[unit]]
id = 3
"""

ROLES = """
[roles.Viewer]
read = [
    "coils", "fifo", { table = "holding_registers", address = 0, count = 10 },
    { table = "file", file = 4, address = 0, count = 10 },
]
functions = ["43/14"]
[roles."Shift leader"]
read = "all"
write = [{ table = "holding_registers", address = 20, count = 1 }]
[roles.""]
functions = [17]
"""

LEADER, VIEWER, NO_ROLE, EMPTY = "Shift leader", "Viewer", None, ""

# Unit, request, and the roles that may send it. Unit 2 has rules of its own.
ALLOWED: list[tuple[int, pdu.Request[Any], set[str | None]]] = [
    (1, pdu.ReadHoldingRegisters(0, 10), {VIEWER, LEADER}),
    (1, pdu.ReadHoldingRegisters(0, 11), {LEADER}),
    (1, pdu.WriteRegister(20, 1), {LEADER}),
    (1, pdu.WriteRegister(21, 1), set()),
    (1, pdu.ReadDeviceIdentification(1), {VIEWER}),
    (1, pdu.ReportServerId(), {NO_ROLE}),
    (1, pdu.ReadFifoQueue(5), {VIEWER, LEADER}),
    (1, pdu.ReadFileRecords(((4, 0, 10),)), {VIEWER, LEADER}),
    (1, pdu.ReadFileRecords(((4, 0, 11),)), {LEADER}),
    (2, pdu.ReadHoldingRegisters(0, 10), set()),
    (2, pdu.WriteRegister(20, 1), {"Engineer"}),
    (3, pdu.ReadHoldingRegisters(0, 11), {LEADER}),
]


def allowed(text: str, unit: int, request: pdu.Request[Any]) -> set[str | None]:
    """Return the roles whose request is not refused as an illegal function."""
    devices = parse(text).devices
    assert isinstance(devices, dict)
    return {
        role
        for role in (VIEWER, LEADER, "Engineer", NO_ROLE, EMPTY)
        if devices[unit].answer(request.encode(), Caller(1, role=role))[:2]
        != bytes([request.function | 0x80, 1])
    }


@each_case(("number", "request_", "roles"), ALLOWED, ids=str)
def test_a_role_may_do_what_its_rules_allow(number, request_, roles) -> None:
    assert allowed(UNITS + ROLES, number, request_) == roles


@each_case("text", ["roles = {}\n", "[roles]\n", "[roles.Viewer]\n"])
def test_a_role_without_rules_may_do_nothing(text: str) -> None:
    assert allowed(text + UNITS, 1, pdu.ReadHoldingRegisters(0, 10)) == set()
