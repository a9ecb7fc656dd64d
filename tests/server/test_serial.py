"""
A server on a serial line: noise, requests to others, and a port that is unplugged.
"""

from __future__ import annotations

import asyncio
import fcntl
import os
from pathlib import Path

import pytest

from libmodbus_py import AsciiContext, Device, Mapping, RtuContext, Server, framing, pdu
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.server import serial as serial_server
from libmodbus_py.server.limits import ServerStatistics
from libmodbus_py.server.serial import SerialServer
from libmodbus_py.server.server import Devices
from libmodbus_py.server.units import Units
from libmodbus_py.tools.testing.wires import SerialWire
from tests.support.peers import until


@pytest.mark.parametrize("noise", [b"\x00", b"\xff\xff", b"\x01\x03", bytes(range(40)), b":0103"])
@pytest.mark.parametrize("kind", ["rtu", "ascii"])
def test_serial_server_answers_the_next_request_after_noise(kind: str, noise: bytes) -> None:
    device = Device(Mapping(holding_registers=2))
    make = RtuContext if kind == "rtu" else AsciiContext
    with (
        SerialWire() as wire,
        Server({1: device}).background(f"{kind}://{wire.server}?baudrate=115200"),
        make(wire.client, 115200, timeout=0.5) as context,
    ):
        for _ in range(3):
            os.write(context._driver._port.descriptor, noise)
            assert context.read_holding_registers(0, 2) == [0, 0]


def test_serial_server_stays_silent_while_others_talk() -> None:
    """Requests to unit 2, and its answers, pass by; only unit 1 is answered."""
    framer = framing.RtuFramer("client")
    device = Device(Mapping(holding_registers=10))
    foreign = [
        framing.Frame(2, pdu.ReadHoldingRegisters(0, 10).encode()),
        framing.Frame(2, b"\x03\x14" + bytes(range(20))),
        framing.Frame(2, pdu.WriteRegister(0, 3).encode()),
        framing.Frame(2, b"\x86\x02"),
    ]
    with (
        SerialWire() as wire,
        Server({1: device}).background(f"rtu://{wire.server}?baudrate=115200"),
        RtuContext(wire.client, 115200, timeout=0.5) as context,
    ):
        for frame in foreign * 3:
            os.write(context._driver._port.descriptor, framer.encode(frame))
            assert context.read_holding_registers(0, 2) == [0, 0]
        assert wire.sent_by("server").count(b"\x01\x03\x04") == 12


def test_an_unplugged_port_is_opened_again(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The path stays, as udev keeps it; what it leads to is another port."""
    monkeypatch.setattr(serial_server, "REOPEN_AFTER", 0.05)
    path = tmp_path / "ttyUSB0"
    with SerialWire() as first, SerialWire() as second:
        path.symlink_to(first.server)
        with Server({17: device}).background(f"rtu://{path}"):
            with RtuContext(first.client, unit=17, timeout=0.5) as context:
                assert context.read_holding_registers(100, 1) == [1000]
            first.unplug()
            path.unlink()
            path.symlink_to(second.server)
            with RtuContext(second.client, unit=17, timeout=5) as context:
                wait_until_open(second.server)
                assert context.read_holding_registers(100, 1) == [1000]


def wait_until_open(path: str) -> None:
    """A port that is served is locked."""
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY)

    def is_locked() -> bool:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        fcntl.flock(descriptor, fcntl.LOCK_UN)
        return False

    try:
        until(is_locked)
    finally:
        os.close(descriptor)


@pytest.mark.parametrize(
    ("url", "data_bits", "is_silent"),
    [("ascii://{}", 7, False), ("ascii://{}?data_bits=8", 8, False), ("rtu://{}", 8, True)],
)
def test_ascii_ports_have_seven_data_bits(
    device: Device, url: str, data_bits: int, is_silent: bool
) -> None:
    """Pseudo-terminals ignore them, so what the port is told is looked at."""

    async def made() -> SerialServer:
        service = Devices(Units(device))
        return SerialServer(parse(url.format("/dev/null")), service, ServerStatistics())

    port = asyncio.run(made())._port
    assert port.data_bits == data_bits
    assert (port.silence.seconds > 0) is is_silent
