"""Servers with faults and requests to them, for the tests of faults."""

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from libmodbus_py import Client, Device, Mapping, Server, pdu
from libmodbus_py.protocol.framing import Frame
from libmodbus_py.tools.faults.fault import Fault
from tests.simulation.lan import Lan

FOREVER = 600.0  # longer than any test may last

READ = pdu.ReadHoldingRegisters(0, 1).encode()
REQUEST = Frame(1, READ)


def make_device() -> Device:
    mapping = Mapping(coils=8, holding_registers=8)
    mapping.holding_registers[0:3] = [555, 0, 100]
    return Device(mapping)


@contextmanager
def serving(
    lan: Lan, scheme: str, *faults: Fault, of: int | None = 1, **devices: Any
) -> Iterator[str]:
    """Serve units 1 and 2 on a LAN, of which one or all have faults; yield a URL for clients."""
    units = devices.get("units") or {1: make_device(), 2: make_device()}
    place = "tcp://10.0.0.1:0" if scheme.endswith("tcp") else "x:///dev/line?baudrate=115200"
    with Server(units, faults={of: faults}).background(
        scheme + place[place.index(":") :]
    ) as running:
        yield running.urls[0]


def client_of(url: str, unit: int = 1, timeout: float = 5000) -> Client:
    return Client(url, unit=unit, timeout=timeout)


def adu(body: bytes, transaction: int = 1, unit: int = 1) -> bytes:
    return struct.pack(">HHHB", transaction, 0, 1 + len(body), unit) + body
