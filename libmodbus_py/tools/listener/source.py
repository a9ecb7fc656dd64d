"""
The sources of bytes, with the time of each piece: a serial port, or a tap.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

from ...ports.endpoint import Endpoint
from .separator import Direction

__all__ = ["SerialSource", "Source", "TimedBytes"]


class TimedBytes(NamedTuple):
    """
    Bytes that were received together.

    Attributes:
        link: the number of the connection; 0 on a serial line.
        sender: "client" or "server"; None on a serial line, where the sender is not known.
        at: the time at which they arrived, in seconds.
        data: empty at the end of a connection.
    """

    link: int
    sender: Direction | None
    at: float
    data: bytes


class Source(Protocol):
    """The common part of all sources."""

    @property
    def descriptor(self) -> int:
        """A descriptor that is readable when there are bytes to receive."""
        ...

    def open(self) -> None:
        """
        Open the source, or open it again.

        Raises:
            ModbusConnectionError: the source cannot be opened, with errno.
        """
        ...

    def receive(self) -> list[TimedBytes]:
        """
        Return the received bytes, oldest first.

        Raises:
            ModbusConnectionError: the port was removed, or failed.
        """
        ...

    def close(self) -> None:
        """Close the source; any number of times."""
        ...


class SerialSource:
    """
    A serial port that is only read.

    Raises:
        TypeError, ValueError: a setting is wrong.
    """

    def __init__(self, endpoint: Endpoint, clock: Callable[[], float]) -> None:
        from ...ports.serial import ReadOnlySerialPort  # which not every system has

        self._port = ReadOnlySerialPort(endpoint.path, **endpoint.serial_settings)
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
