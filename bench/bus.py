"""
A serial line with several units, none of which waits for another, as on a real wire.
"""

from __future__ import annotations

import os
import select
import socket
import threading
import time
import tty
from collections import Counter
from contextlib import ExitStack
from typing import Self

from libmodbus_py.tools.testing.wires import SerialWire

__all__ = ["Bus"]

REQUEST_SIZE = 8
UNITS = range(1, 4)


class Bus:
    """
    Units 1 to 3, which answer reads of one register, each with values that no other unit has.

    Args:
        late: unit -> n, if every n-th response of this unit is late.
        seconds: the delay of late responses.

    Attributes:
        path: the pseudo-terminal of the client.
    """

    path: str

    def __init__(self, late: dict[int, int] | None = None, seconds: float = 0.0) -> None:
        self._late = late or {}
        self._seconds = seconds
        self._requests: Counter[int] = Counter()
        self._due: list[tuple[float, bytes]] = []
        self._stack = ExitStack()

    @staticmethod
    def value(unit: int, address: int) -> int:
        """Return the value of a register of a unit."""
        return (unit * 10_000 + address) & 0xFFFF

    def __enter__(self) -> Self:
        wire = self._stack.enter_context(SerialWire())
        self.path = wire.client
        line = os.open(wire.server, os.O_RDWR | os.O_NOCTTY)
        self._stack.callback(os.close, line)
        tty.setraw(line)
        stop, stopped = socket.socketpair()
        self._stack.callback(stopped.close)
        thread = threading.Thread(target=self._serve, args=(line, stopped))
        thread.start()
        self._stack.callback(thread.join)
        self._stack.callback(stop.close)
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _serve(self, line: int, stopped: socket.socket) -> None:
        received = b""
        while True:
            next_at = min((at for at, _ in self._due), default=None)
            wait = None if next_at is None else max(0.0, next_at - time.monotonic())
            ready, _, _ = select.select([line, stopped], [], [], wait)
            if stopped in ready:
                return
            self._write_due(line)
            if line in ready:
                received += os.read(line, 4096)
                while len(received) >= REQUEST_SIZE:
                    self._answer(line, received[0], int.from_bytes(received[2:4], "big"))
                    received = received[REQUEST_SIZE:]

    def _write_due(self, line: int) -> None:
        for at, response in sorted(self._due):
            if at <= time.monotonic():
                self._due.remove((at, response))
                os.write(line, response)

    def _answer(self, line: int, unit: int, address: int) -> None:
        if unit not in UNITS:
            return
        body = bytes([unit, 3, 2]) + self.value(unit, address).to_bytes(2, "big")
        self._requests[unit] += 1
        if unit in self._late and self._requests[unit] % self._late[unit] == 0:
            self._due.append((time.monotonic() + self._seconds, body + _crc(body)))
        else:
            os.write(line, body + _crc(body))


def _crc(data: bytes) -> bytes:
    """Return the CRC of MODBUS over serial line, section 6.2.2, without the package."""
    found = 0xFFFF
    for byte in data:
        found ^= byte
        for _ in range(8):
            found = found >> 1 ^ (0xA001 if found & 1 else 0)
    return found.to_bytes(2, "little")
