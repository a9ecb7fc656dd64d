"""
Datagrams that are not a frame: each is counted once, for no later one completes it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import pytest

from libmodbus_py import Device, Fault, Gateway, Mapping, Route, Server
from libmodbus_py.ports.schemes import SCHEMES, TRANSPORTS
from libmodbus_py.server.limits import ServerStatistics
from tests.simulation.stage import Stage
from tests.support.talk import ascii_frame, rtu, tcp

FRAMES: dict[str, Callable[[str], bytes]] = {
    "rtu": rtu,
    "ascii": ascii_frame,
    "udp": lambda text: tcp(bytes(2), text[2:], unit=int(text[:2], 16)),
}

DATAGRAMS: dict[str, Callable[[str], bytes]] = {
    scheme: FRAMES[framing]
    for scheme, (framing, transport) in SCHEMES.items()
    if TRANSPORTS[transport].is_datagram
}
"""Scheme -> what makes its frames."""

# Requests to the unit that answers and to another, a broadcast, and answers of another unit.
BODIES = ["01 03 0000 0001", "02 03 0000 0001", "00 06 0001 0003", "02 10 0000 0001 02 0007"]
ANSWERS = ["02 80 02", "02 83 02", "02 03 02 0007", "02 11 02 07 FF"]


@contextmanager
def plain(url: str) -> Iterator[ServerStatistics]:
    server = Server({1: Device(Mapping(holding_registers=4))})
    with server.background(url):
        yield server.statistics


@contextmanager
def with_faults(url: str) -> Iterator[ServerStatistics]:
    device = Device(Mapping(holding_registers=4))
    server = Server({1: device}, {1: [Fault("no_answer", function=100)]})
    with server.background(url):
        yield server.statistics


@contextmanager
def gateway(url: str) -> Iterator[ServerStatistics]:
    back = "rtu:///dev/back?baudrate=115200"
    made = Gateway([Route(back, units="1")])
    with Server({1: Device(Mapping(holding_registers=4))}).background(back), made.background(url):
        yield made.statistics


def damaged(scheme: str) -> Iterator[bytes]:
    """Yield what is not a frame: each frame up to each of its bytes, and with a wrong check."""
    made = DATAGRAMS[scheme]
    for body in BODIES + ANSWERS:
        frame = made(body)
        yield from (frame[:size] for size in range(1, len(frame)))
        if "+" in scheme:
            yield frame[:-3] + bytes([frame[-3] ^ 1]) + frame[-2:]
    yield b"\xff"


@pytest.mark.parametrize("serving", [plain, with_faults, gateway])
@pytest.mark.parametrize("scheme", DATAGRAMS)
def test_a_datagram_that_is_no_frame_is_counted_once(
    stage: Stage, scheme: str, serving: Callable[..., AbstractContextManager[ServerStatistics]]
) -> None:
    url, made = f"{scheme}://10.0.0.1:1502", DATAGRAMS[scheme]
    with serving(url) as statistics, stage.talk(url) as client:
        for count, datagram in enumerate(damaged(scheme), 1):
            client.sendall(datagram)
            stage.pass_time(0.01)
            assert statistics.bad_frames == count, datagram
        assert statistics.requests == 0
        client.sendall(made("01 03 0000 0001"))
        stage.pass_time(1)
        assert client.recv(300) == made("01 03 02 0000")
        assert statistics.bad_frames == count
