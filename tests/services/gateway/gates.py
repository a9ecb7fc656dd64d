"""
Gateways between clients and devices, for the tests that need a whole one.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

from libmodbus_py import Device, Gateway, Mapping, Route, framing
from libmodbus_py.services.gateway.statistics import LineStatistics
from tests.simulation.scripted import Scripted, Write
from tests.simulation.stage import Stage

READ_ONE = bytes.fromhex("03 0000 0001")


def adu(data: bytes, transaction: int = 1, unit: int = 1) -> bytes:
    return struct.pack(">HHHB", transaction, 0, 1 + len(data), unit) + data


LINE = "rtu:///dev/line"


def small() -> Device:
    return Device(Mapping(10, 10, 10, 10))


class Gate:
    """Unit 1 on the line behind a gateway, which answers from when it is opened on."""

    def __init__(self, stage: Stage) -> None:
        self.asked: list[int] = []
        self.kinds: list[str] = []
        self._device = Device(Mapping(10, 10, 10, 10))
        self._device.mapping.holding_registers[7] = 7
        self._framer = framing.make_framer("rtu", "server")
        self._is_open = False
        self._held: list[tuple[bytes, Write]] = []
        Scripted(stage, LINE, self._take)

    def open(self) -> None:
        self._is_open = True
        held, self._held = self._held, []
        for request, write in held:
            self._answer(request, write)

    def _take(self, request: bytes, write: Write) -> None:
        self.asked.append(int.from_bytes(request[2:4], "big"))
        self.kinds.append("read" if request[1] == 3 else "write")
        if self._is_open:
            self._answer(request, write)
        else:
            self._held.append((request, write))

    def _answer(self, request: bytes, write: Write) -> None:
        answer = self._device.answer(request[1:-2])
        write(self._framer.encode(framing.Frame(request[0], answer)))


@contextlib.contextmanager
def gated(stage: Stage, route: dict[str, Any] | None = None, **options: Any) -> Iterator[Gated]:
    """A gateway before a gate, with its line and where clients find it."""
    gate = Gate(stage)
    made = Gateway([Route(f"{LINE}?timeout=1000", **(route or {}))], longest_wait=5000, **options)
    with made.background("tcp://10.0.0.1:0") as running:
        (line,) = made.traffic.lines.values()
        yield Gated(gate, line, running.urls[0], made)


class Gated(NamedTuple):
    gate: Gate
    line: LineStatistics
    url: str
    made: Gateway


def numbered(number: int) -> Device:
    device = small()
    device.mapping.holding_registers[0] = number
    return device


@contextlib.contextmanager
def gateway(routes: list[Route], *urls: str, **options: Any) -> Iterator[tuple[Gateway, str]]:
    made = Gateway(routes, **options)
    with made.background(*(urls or ("tcp://127.0.0.1:0",))) as running:
        yield made, running.urls[0]
