"""
Where bytes come from, with the time of each piece: a serial port, or what passes a tap.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

from ...ports.endpoint import Endpoint
from ...ports.read_only import ReadOnlySerialPort
from .separator import Direction

__all__ = ["SerialSource", "Source", "TimedBytes"]


class TimedBytes(NamedTuple):
    """
    Bytes that came together.

    Attributes:
        link: number of the connection; 0 on a serial line.
        sender: whose they are; None on a line, where nobody can know.
        at: when they came, in seconds.
        data: none where the connection ended.
    """

    link: int
    sender: Direction | None
    at: float
    data: bytes


class Source(Protocol):
    """What sources have in common."""

    @property
    def descriptor(self) -> int:
        """Readable once there is something to receive."""
        ...

    def open(self) -> None:
        """
        Open it, again if need be.

        Raises:
            ModbusConnectionError: it cannot be opened, with errno.
        """
        ...

    def receive(self) -> list[TimedBytes]:
        """
        Give what has come, oldest first.

        Raises:
            ModbusConnectionError: the port is gone.
        """
        ...

    def close(self) -> None:
        """Any number of times."""
        ...


class SerialSource:
    """
    A serial port that is only read.

    Raises:
        TypeError, ValueError: a setting is wrong.
    """

    def __init__(self, endpoint: Endpoint, clock: Callable[[], float]) -> None:
        self._port = ReadOnlySerialPort(endpoint.device, **endpoint.serial_settings)
        self._clock = clock

    @property
    def descriptor(self) -> int:
        return self._port.descriptor

    def open(self) -> None:
        self._port.open()

    def receive(self) -> list[TimedBytes]:
        return [TimedBytes(0, None, self._clock(), data) for data in self._port.receive()]

    def close(self) -> None:
        self._port.close()
