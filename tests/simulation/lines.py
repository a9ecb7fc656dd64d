"""Serial lines in memory: what one party writes, all others hear, a character at a time."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterable
from typing import Any

from libmodbus_py.ports.direction import Switch
from libmodbus_py.ports.serial import SerialPort
from libmodbus_py.ports.waiting import Waker
from libmodbus_py.protocol.errors import ModbusConnectionError

from .events import Events
from .loop import Descriptors

Noise = Callable[[bytes], Iterable[tuple[float, bytes]]]
"""Returns, for what was written: pieces as they are heard, and how many seconds later each is."""


def undisturbed(data: bytes) -> Iterable[tuple[float, bytes]]:
    """Deliver all bytes as soon as the line has carried them."""
    return [(0.0, data)]


class SerialLine:
    """A line, and who is on it."""

    def __init__(self, events: Events) -> None:
        self.noise: Noise = undisturbed
        self.on_written: Callable[[bool, bytes], object] | None = None
        self.is_unplugged: bool = False
        self._events = events
        self.character: float = 0.0  # seconds of a byte; else of the first port that opens the line
        self._busy: dict[Party, float] = {}  # until when each sender still sends
        self.parties: list[Party] = []

    def join(self, party: Party) -> None:
        self.parties.append(party)

    def leave(self, party: Party) -> None:
        if party in self.parties:
            self.parties.remove(party)

    def write(self, sender: Party, data: bytes) -> None:
        """Carry bytes to all others."""
        if self.on_written is not None:
            self.on_written(sender.is_unit, data)
        start = max(self._events.now, self._busy.get(sender, 0.0))
        end = self._busy[sender] = start + len(data) * self.character
        for later, piece in self.noise(data):
            self._events.at(end + later, self._tell, sender, piece)

    def unplug(self) -> None:
        """Take the adapter out: whoever has a port open finds it gone."""
        self.is_unplugged = True
        for party in list(self.parties):
            party.gone()

    def _tell(self, sender: Party, data: bytes) -> None:
        for party in list(self.parties):
            if party is not sender:
                party.hear(data)


class Party:
    """Who hears what others write."""

    is_unit: bool = False

    def hear(self, data: bytes) -> None:
        """Take bytes."""

    def gone(self) -> None:
        """The line was unplugged."""


class MemorySerialPort(SerialPort, Party):
    """A `SerialPort` whose device is a line in memory."""

    def __init__(
        self,
        descriptors: Descriptors,
        line: SerialLine,
        waker: Callable[[], Waker],
        device: str,
        **settings: Any,
    ) -> None:
        super().__init__(device, **settings)
        self._descriptors = descriptors
        self._line = line
        self._waker = waker
        self._inbox = b""
        self._is_lost = False
        if isinstance(self.rs485, str):
            self._switch = Switch(lambda is_sending: None)  # a line in memory has no RTS

    def waker(self) -> Waker:
        return self._waker()

    def open(self) -> None:
        if self._line.is_unplugged:
            raise ModbusConnectionError(
                f"cannot open {self.device}: {os.strerror(errno.ENOENT)}", errno=errno.ENOENT
            )
        self.descriptor = self._descriptors.new()
        self._inbox, self._is_lost = b"", False
        self._line.character = self._line.character or self.character
        self._line.join(self)

    def has_input(self) -> bool:
        return self.descriptor in self._descriptors.readable

    def hear(self, data: bytes) -> None:
        self._inbox += data
        self._follow()

    def gone(self) -> None:
        self._is_lost = True
        self._follow()

    def receive(self) -> list[bytes]:
        data, self._inbox = self._inbox, b""
        self._follow()
        if not data and self._is_lost:
            raise ModbusConnectionError("the port is gone", errno=errno.EIO)
        return [data] if data else []

    def discard_input(self) -> None:
        self._inbox = b""
        self._follow()

    def close(self) -> None:
        self.resume_at = None
        if self._switch is not None:
            self._switch.close()
        self.abandon()

    def abandon(self) -> None:
        if self.descriptor >= 0:
            self._line.leave(self)
            self._descriptors.forget(self.descriptor)
            self.descriptor = -1

    def _write(self, data: bytes) -> None:
        if self._is_lost:
            raise ModbusConnectionError(os.strerror(errno.EIO), errno=errno.EIO)
        self._line.write(self, data)

    def _follow(self) -> None:
        if self.descriptor >= 0:
            change = self._descriptors.readable
            (change.add if self._inbox or self._is_lost else change.discard)(self.descriptor)
