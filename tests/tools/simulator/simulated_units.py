"""Units of device files, and a clock that tests set."""

import time
from collections.abc import Callable
from typing import Any

from hypothesis import strategies as st

from libmodbus_py import Device, pdu
from libmodbus_py.tools.simulator.device_file import parse


class Clock:
    """A clock that moves only when it is told to."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def unit(text: str, clock: Callable[[], float] = time.monotonic) -> Device:
    """Return the device of a file with one unit, from the text of its keys."""
    devices = parse(f"[[unit]]\n{text}", clock=clock).devices
    assert isinstance(devices, Device)
    return devices


def answer(device: Device, request: pdu.Request[Any]) -> Any:
    """Return the decoded response that a client gets; raise its exceptions."""
    return request.decode_response(device.answer(request.encode()))


def holding(device: Device, address: int, count: int = 1) -> Any:
    return answer(device, pdu.ReadHoldingRegisters(address, count))


def inputs(device: Device, address: int, count: int = 1) -> Any:
    return answer(device, pdu.ReadInputRegisters(address, count))


numbers = st.integers(-100_000, 100_000) | st.floats(-1e5, 1e5)
