"""
A serial bus with devices that hear only what is sent at their own rate: a pseudo-terminal.

It carries every byte whatever the settings, but its master can read those of its slave; parity
is none of them, as a pseudo-terminal has none, but stop bits are.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import termios
import threading
import time
from collections.abc import Callable
from typing import NamedTuple, Self

from libmodbus_py import Device, framing
from libmodbus_py.device.caller import Caller
from libmodbus_py.tools.testing.wires import open_line, read_what_is_there

RATES = {getattr(termios, name): int(name[1:]) for name in dir(termios) if name[1:].isdigit()}

# A request PDU -> the answer PDU, or None for silence; EOFError takes the port away.
Answer = Callable[[bytes], bytes | None]


class Member(NamedTuple):
    """
    One device.

    Attributes:
        answer: what it answers.
        baudrate, stop_bits: at which it is heard.
        after: seconds that it takes.
        garbles: whether it is heard at other settings, too, as damaged bytes.
    """

    answer: Answer
    baudrate: int
    stop_bits: int = 1
    after: float = 0.0
    garbles: bool = False


def of(device: Device) -> Answer:
    """Let a device of ours answer."""
    return lambda pdu: device.answer(pdu, Caller(1, "test"))


class Bus:
    """
    Units on a line; `path` is where the client goes.

    Attributes:
        asked: every request, as (baudrate, unit, PDU).
    """

    def __init__(self, units: dict[int, Member]) -> None:
        self._units = units
        self._master, self._slave, self.path = open_line()
        self.url = f"rtu://{self.path}"
        self.asked: list[tuple[int, int, bytes]] = []
        self._wake, self._sleep = socket.socketpair()
        self._timers: list[tuple[float, bytes]] = []
        self._thread = threading.Thread(target=self._serve, name="bus", daemon=True)

    def __enter__(self) -> Self:
        self._before = termios.tcgetattr(self._slave)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._wake.close()
        self._thread.join()
        self._sleep.close()
        self._close()

    def _close(self) -> None:
        for descriptor in (self._master, self._slave):
            with contextlib.suppress(OSError):
                os.close(descriptor)
        self._master = self._slave = -1

    @property
    def is_restored(self) -> bool:
        """True if the client left the settings that it found."""
        return termios.tcgetattr(self._slave) == self._before

    def _serve(self) -> None:
        framer = framing.make_framer("rtu", "server")
        while True:
            now = time.monotonic()
            for due, data in list(self._timers):
                if due <= now:
                    self._timers.remove((due, data))
                    self._write(data)
            waits = [max(0.0, due - now) for due, _ in self._timers]
            ready, _, _ = select.select(
                [self._master, self._sleep], [], [], min(waits, default=None)
            )
            if self._sleep in ready:
                return
            if self._master in ready:
                try:
                    self._hear(framer)
                except EOFError:
                    self._close()
                    return

    def _write(self, data: bytes) -> None:
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, data)

    def _hear(self, framer: framing.Framer) -> None:
        if not (data := read_what_is_there(self._master)):
            return
        settings = termios.tcgetattr(self._master)
        baudrate = RATES[settings[5]]
        stop_bits = 2 if settings[2] & termios.CSTOPB else 1
        frames = [each for each in framer.scan(data) if isinstance(each, framing.Frame)]
        for frame in frames:
            self.asked.append((baudrate, frame.unit, frame.pdu))
            member = self._units.get(frame.unit)
            if member is None:
                continue
            pdu = member.answer(frame.pdu)
            if pdu is None:
                continue
            adu = framer.encode(framing.Frame(frame.unit, pdu))
            if (member.baudrate, member.stop_bits) != (baudrate, stop_bits):
                if not member.garbles:
                    continue
                adu = bytes(byte ^ 0xA5 for byte in adu[:5])
            self._timers.append((time.monotonic() + member.after, adu))
