"""
A port: a descriptor that is opened and closed any number of times.
"""

from __future__ import annotations

import select
from abc import ABC, abstractmethod
from typing import Any

from ..protocol.errors import ModbusConnectionError
from .waiting import Steps, Waker, of_system

__all__ = ["Port", "Silence", "lost"]


class Silence:
    """
    The silence that a line needs before a frame is sent; times are those of time.monotonic().

    Args:
        seconds: the time without a byte.
        character: seconds that one byte takes on the line.
        turn: seconds before and after each frame sent, for turning the line round; else 0.

    Attributes:
        over_at: the time from which frames may be sent.
    """

    def __init__(self, seconds: float = 0.0, character: float = 0.0, turn: float = 0.0) -> None:
        self.seconds = seconds
        self.character = character
        self.over_at: float = 0.0
        self._turn = turn
        self._turned_at = 0.0

    def heard(self, now: float) -> None:
        """Note that a byte came."""
        self.over_at = max(now + self.seconds, self._turned_at)

    def sent(self, size: int, now: float) -> None:
        """Note bytes that were passed to the driver; the last one leaves later."""
        gone_at = now + size * self.character + 2 * self._turn
        self.over_at = gone_at + self.seconds
        self._turned_at = gone_at if self._turn else 0.0


class Port(ABC):
    """
    A TCP connection, a UDP socket or a serial port; nothing here waits.

    Attributes:
        descriptor: the descriptor to wait for; -1 while closed.
        context: the context of libmodbus, where that opens the port; else None.
        silence: the silence that must pass before sending.
        resume_at: the time when `go_on` should be called (time.monotonic), or None.
        has_unsent: True if `go_on` should be called once the port takes bytes again.
    """

    descriptor: int = -1
    context: Any = None
    silence: Silence
    resume_at: float | None = None
    has_unsent = False

    @abstractmethod
    def opening(self, deadline: float) -> Steps[None]:
        """
        Open the port.

        Raises:
            ModbusConnectionError: the port cannot be opened, with errno.
        """

    def waker(self) -> Waker:
        """Return the waker of a blocking client."""
        return Waker()

    def has_input(self) -> bool:
        """Return True if something can be read: bytes, or the end of the connection."""
        return bool(self._poll.poll(0))

    def _watch(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLIN)

    @abstractmethod
    def receive(self) -> list[bytes]:
        """
        Return received bytes, one item for each datagram; an empty list if there are none.

        Raises:
            ModbusConnectionError: the other side closed, or the port is gone.
        """

    @abstractmethod
    def send(self, adus: list[bytes], now: float) -> None:
        """
        Send as much as possible at once; `has_unsent` and `resume_at` are set if a rest remains.

        Raises:
            ModbusConnectionError: the port is gone.
        """

    def go_on(self, now: float) -> None:  # noqa: B027  # most ports have sent all
        """Send the rest. Raises ModbusConnectionError."""

    def discard_input(self) -> None:  # noqa: B027  # on a network no byte is noise
        """Discard received bytes."""

    def acknowledge(self) -> None:  # noqa: B027  # only TCP does
        """Make the system acknowledge received bytes at once, so that the peer sends more."""

    @abstractmethod
    def close(self) -> None:
        """Restore the settings of the line and close the port; may be called repeatedly."""

    @abstractmethod
    def abandon(self) -> None:
        """Close the descriptor without an effect on the line, which belongs to a parent process."""


def lost(error: OSError) -> ModbusConnectionError:
    """
    Return the error for a port that is gone, with the words of the system.

    Raises:
        OSError: the error itself, if it is not the system's: see `of_system`.
    """
    of_system(error)
    made = ModbusConnectionError(error.strerror or str(error), errno=error.errno)
    made.__cause__ = error
    return made
