"""
Roles in device files: what they allow, and what a wrong one is told.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Device, pdu
from libmodbus_py.serve import Caller
from libmodbus_py.tools.simulator.device_file import load, parse

PLANT = Path(__file__).parents[3] / "examples" / "plant.toml"

UNITS = """
[[unit]]
id = 1
[[unit.holding_registers]]
address = 0
count = 100
[[unit.coils]]
address = 0

[[unit]]
id = 2
[[unit.holding_registers]]
address = 0
count = 100
"""


def devices(text: str) -> dict[int, Device]:
    found = parse(text).devices
    assert isinstance(found, dict)
    return found


def code(device: Device, request: pdu.Request[Any], role: str | None) -> int:
    answer = device.answer(request.encode(), Caller(1, role=role))
    return answer[1] if answer[0] & 0x80 else 0


READ, WRITE = pdu.ReadHoldingRegisters(0, 10), pdu.WriteRegister(20, 1)


def test_without_roles_all_is_allowed() -> None:
    for device in devices(UNITS).values():
        for role in (None, "Viewer"):
            assert code(device, READ, role) == code(device, WRITE, role) == 0


def test_one_role_refuses_the_rest() -> None:
    text = """
    [roles.Viewer]
    read = ["coils", {table = "holding_registers", address = 0, count = 10}]
    functions = ["43/14"]
    [roles."Shift leader"]
    read = "all"
    write = [{table = "holding_registers", address = 20, count = 1}]
    [roles.""]
    functions = [17]
    """
    for device in devices(UNITS + text).values():
        for role, read, write, identify, server_id in (
            ("Viewer", 0, 1, 0, 1),
            ("Shift leader", 0, 0, 1, 1),
            (None, 1, 1, 1, 0),
            ("Engineer", 1, 1, 1, 1),
            ("", 1, 1, 1, 1),
        ):
            assert code(device, READ, role) == read
            assert code(device, WRITE, role) == write
            assert code(device, pdu.ReadDeviceIdentification(1), role) == identify
            assert code(device, pdu.ReportServerId(), role) == server_id
        assert code(device, pdu.ReadHoldingRegisters(0, 11), "Viewer") == 1
        assert code(device, pdu.WriteRegister(21, 1), "Shift leader") == 1


def test_a_unit_may_have_its_own() -> None:
    text = UNITS + '[unit.roles.Engineer]\nwrite = "all"\n[roles.Viewer]\nread = "all"\n'
    first, second = devices(text).values()
    assert [code(first, READ, role) for role in ("Viewer", "Engineer")] == [0, 1]
    assert [code(second, READ, role) for role in ("Viewer", "Engineer")] == [1, 1]
    assert [code(second, WRITE, role) for role in ("Viewer", "Engineer")] == [1, 0]


@pytest.mark.parametrize("text", ["roles = {}\n", "[roles]\n", "[roles.Viewer]\n"])
def test_no_rule_allows_nothing(text: str) -> None:
    text = text + UNITS
    for device in devices(text).values():
        assert code(device, READ, None) == code(device, READ, "Viewer") == 1


def test_what_does_not_exist_is_not_told_to_who_may_not_read_it() -> None:
    text = UNITS + '[roles.Viewer]\nread = ["holding_registers"]\n'
    device = devices(text)[1]
    assert code(device, pdu.ReadHoldingRegisters(200, 1), "Viewer") == 2
    assert code(device, pdu.ReadHoldingRegisters(200, 1), None) == 1


def test_files_and_queues() -> None:
    text = """
    [[unit]]
    [[unit.file]]
    number = 4
    record = 0
    count = 100
    [[unit.fifo]]
    address = 5
    values = [1]
    [roles.Viewer]
    read = ["fifo", {table = "file", file = 4, address = 0, count = 10}]
    """
    device = parse(text).devices
    assert isinstance(device, Device)
    assert code(device, pdu.ReadFifoQueue(5), "Viewer") == 0
    assert code(device, pdu.ReadFileRecords(((4, 0, 10),)), "Viewer") == 0
    assert code(device, pdu.ReadFileRecords(((4, 0, 11),)), "Viewer") == 1
    assert code(device, pdu.ReadFileRecords(((3, 0, 1),)), "Viewer") == 1


def test_the_example_does_what_it_says() -> None:
    plant = load(PLANT).devices
    assert isinstance(plant, dict)
    boiler = plant[1]
    allowed = pdu.ReadHoldingRegisters(100, 3)
    assert [code(boiler, allowed, role) for role in (None, "Viewer", "Thief")] == [0, 0, 1]
    for role, expected in (("Operator", 0), ("Viewer", 1), (None, 0)):
        assert code(boiler, pdu.ReportServerId(), role) == expected
