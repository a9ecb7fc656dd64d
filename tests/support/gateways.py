"""
What the tests of gateways share: devices behind a line of any kind, and a gateway before it.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import socket
import threading
import time
from collections import Counter
from collections.abc import Iterator
from typing import Any, NamedTuple, Self

from libmodbus_py import Context, Device, Fault, Gateway, Route, Server
from libmodbus_py.testing.line_ends import open_line, read_what_is_there, write_all
from libmodbus_py.testing.wires import SerialWire
from tests.simulation.stage import Stage
from tests.support.interop import BAUDRATE, UNIT, make_device


class Passage(NamedTuple):
    """
    A gateway that serves.

    Attributes:
        url: where clients find it.
        line: the URL of the line to the devices.
        wire: that line, if it is a serial one.
    """

    gateway: Gateway
    url: str
    line: str
    wire: SerialWire | None

    def context(self, unit: int = UNIT, **options: Any) -> Context:
        return Context.from_url(self.url, unit=unit, **{"timeout": 5.0, **options})


@contextlib.contextmanager
def ends(
    scheme: str, stage: Stage | None = None, name: str = "line"
) -> Iterator[tuple[str, str, SerialWire | None]]:
    """
    Return the two ends of a line: where to listen, and where to find who listens there.

    Args:
        stage: where the line is, in place of the system; then it has this name.
    """
    if stage is not None and scheme in ("rtu", "ascii"):
        url = f"{scheme}:///dev/{name}?baudrate={BAUDRATE}"
        yield url, url, None
    elif scheme in ("rtu", "ascii"):
        with SerialWire() as wire:
            query = f"baudrate={BAUDRATE}"
            yield f"{scheme}://{wire.server}?{query}", f"{scheme}://{wire.client}?{query}", wire
    else:
        yield f"{scheme}://127.0.0.1:0", "", None


@contextlib.contextmanager
def passage(
    front: str = "tcp",
    back: str = "tcp",
    devices: Device | dict[int, Device] | None = None,
    *,
    faults: dict[int | None, list[Fault]] | None = None,
    line_options: str = "timeout=2",
    route: dict[str, Any] | None = None,
    stage: Stage | None = None,
    **options: Any,
) -> Iterator[Passage]:
    """
    Devices on one kind of line, clients on another.

    Args:
        line_options: of the gateway's client, as in URLs.
        route: further arguments of the route; options: of the gateway.
        stage: where all of it is, in place of the system.
    """
    given = {UNIT: make_device()} if devices is None else devices
    with contextlib.ExitStack() as stack:
        here, there, wire = stack.enter_context(ends(back, stage, "back"))
        running = stack.enter_context(Server(given, faults).background(here))
        line = there or running.urls[0]
        line += ("&" if "?" in line else "?") + line_options
        gateway = Gateway([Route(line, **(route or {}))], **options)
        here, there, _ = stack.enter_context(ends(front, stage, "front"))
        running = stack.enter_context(gateway.background(here))
        yield Passage(gateway, there or running.urls[0], line, wire)


class Bus:
    """
    A serial line with several units, as a wire has them: none waits for another.

    Each answers reads of one register, with a value that no other one has.

    Args:
        late: unit -> every so manieth answer of it comes late, by so many seconds.
        damaged: units whose first answer has a wrong CRC.
        units: those that there are; they may come and go.
    """

    def __init__(
        self,
        late: dict[int, int] | None = None,
        seconds: float = 0.0,
        units: range = range(1, 4),
        damaged: tuple[int, ...] = (),
    ) -> None:
        self._late = late or {}
        self._damaged = set(damaged)
        self._seconds = seconds
        self.units = set(units)
        self._asked: Counter[int] = Counter()
        self._due: list[tuple[float, bytes]] = []
        self._master, self._slave, self.path = open_line()
        self._wake, self._sleep = socket.socketpair()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    @staticmethod
    def value(unit: int, address: int) -> int:
        return (unit * 10_000 + address) & 0xFFFF

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._wake.close()
        self._thread.join()
        for descriptor in (self._master, self._slave):
            os.close(descriptor)
        self._sleep.close()

    def _serve(self) -> None:
        received = b""
        while True:
            wait = min((at for at, _ in self._due), default=math.inf) - time.monotonic()
            ready, _, _ = select.select(
                [self._master, self._sleep], [], [], None if wait == math.inf else max(0, wait)
            )
            if self._sleep in ready:
                return
            for at, answer in sorted(self._due):
                if at <= time.monotonic():
                    self._due.remove((at, answer))
                    write_all(self._master, answer)
            if self._master in ready:
                received += read_what_is_there(self._master)
                while len(received) >= 8:  # that is a read
                    self._answer(received[0], int.from_bytes(received[2:4], "big"))
                    received = received[8:]

    def _answer(self, unit: int, address: int) -> None:
        if unit not in self.units:
            return
        body = bytes([unit, 3, 2]) + self.value(unit, address).to_bytes(2, "big")
        answer = body + crc(body)
        if unit in self._damaged:
            self._damaged.remove(unit)
            answer = body + b"\0\0"
        self._asked[unit] += 1
        if unit in self._late and self._asked[unit] % self._late[unit] == 0:
            self._due.append((time.monotonic() + self._seconds, answer))
        else:
            os.write(self._master, answer)


def crc(data: bytes) -> bytes:
    """Serial line, appendix B."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ 0xA001 * (value & 1)
    return value.to_bytes(2, "little")
