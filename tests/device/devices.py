"""Devices and requests that several tests of devices share."""

import copy
import struct
from typing import Any

from libmodbus_py import Device, Mapping, pdu
from libmodbus_py.device.event_log import EventLog
from libmodbus_py.protocol.pdu.interface import identify
from libmodbus_py.serve import Caller

BITS = {1: range(10, 2100), 2: range(20, 2100)}
REGISTERS = {3: range(100, 400), 4: range(200, 400)}
FILES: dict[int, dict[int, int]] = {
    4: {record: record * 7 & 0xFFFF for record in range(10_000)},
    3: {9: 0x33CD, 10: 0x0040, 12: 7},
    65535: {0: 1, 1: 2, 2: 3},
}

# Made once, because each of 10000 records is checked.
RECORD_FILES = Device(Mapping(), files=FILES).files


def new_device() -> Device:
    mapping = Mapping(
        coils=BITS[1],
        discrete_inputs=BITS[2],
        holding_registers=REGISTERS[3],
        input_registers=REGISTERS[4],
    )
    device = Device(mapping)
    device.files.update(copy.deepcopy(RECORD_FILES))
    return device


def contents(device: Device) -> dict[str, Any]:
    """Everything a client could change."""
    names = ("coils", "discrete_inputs", "holding_registers", "input_registers")
    tables = {name: list(getattr(device.mapping, name)) for name in names}
    return tables | {f"file {number}": list(file) for number, file in device.files.items()}


def words(*values: int) -> bytes:
    return struct.pack(f">{len(values)}H", *values)


def on_a_line() -> Caller:
    return Caller(1, "/dev/ttyS0", EventLog(is_serial=True))


def diagnose(device: Device, sub_function: int, data: bytes = b"\0\0", *caller: Caller) -> bytes:
    return device.answer(b"\x08" + words(sub_function) + data, *caller)


def caller_on(serial: bool) -> Caller:
    return Caller(1, "", EventLog(is_serial=serial))


def identified(device: Device, level: str | int) -> tuple[pdu.DeviceIdentification, list[int]]:
    """Return the objects that a client gets, and the lengths of the responses."""
    steps = identify(level)
    request = next(steps)
    sizes: list[int] = []
    while True:
        answer = device.answer(request.encode())
        sizes.append(len(answer))
        try:
            request = steps.send(request.decode_response(answer))
        except StopIteration as done:
            return done.value, sizes


def page(code: int, number: int = 0) -> bytes:
    return bytes([0x2B, 0x0E, code, number])
