"""
A port: a descriptor that is opened and closed any number of times.
"""

from __future__ import annotations

import select
from abc import ABC, abstractmethod
from typing import Any

from ..protocol.errors import ModbusConnectionError
from .waiting import Steps, Waker

__all__ = ["Port", "Silence", "lost"]


class Silence:
    """
    The silence that a line needs before a frame is sent; times are those of time.monotonic().

    Args:
        seconds: without a byte.
        character: seconds that one byte takes on the line.
        turn: seconds before and after what is sent, for turning the line round; else 0.

    Attributes:
        over_at: when the line may be sent on.
        left_at: when the last byte that was sent has left: no answer comes sooner.
        is_timed: whether bytes take the time that the settings say; not on pseudo-terminals.
    """

    def __init__(self, seconds: float = 0.0, character: float = 0.0, turn: float = 0.0) -> None:
        self.seconds = seconds
        self.character = character
        self.over_at: float = 0.0
        self.left_at: float = 0.0
        self.is_timed: bool = True
        self._turn = turn
        self._turned_at = 0.0

    def heard(self, now: float) -> None:
        """A byte came; if it is an answer, all that was sent has left."""
        self.over_at = max(now + self.seconds, self._turned_at)

    def sent(self, size: int, now: float) -> None:
        """The driver takes the bytes at once; the last one leaves later."""
        gone_at = now + size * self.character + 2 * self._turn
        self.over_at = gone_at + self.seconds
        self.left_at = gone_at - self._turn if self.is_timed else now
        self._turned_at = gone_at if self._turn else 0.0


class Port(ABC):
    """
    A TCP connection, a UDP socket or a serial port; nothing here waits.

    Attributes:
        descriptor: for whoever waits; -1 while closed.
        context: libmodbus's, where it opens the port; else None.
        silence: what must pass before sending.
        resume_at: when `go_on` should be called (time.monotonic), or None.
        has_unsent: whether `go_on` should be called once the port takes bytes again.
    """

    descriptor: int = -1
    context: Any = None
    silence: Silence
    resume_at: float | None = None
    has_unsent = False

    @abstractmethod
    def opening(self, deadline: float) -> Steps[None]:
        """
        Open it.

        Raises:
            ModbusConnectionError: with errno.
        """

    def waker(self) -> Waker:
        """Return what a blocking client waits with."""
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
        Return what was received, one item for each datagram; an empty list if there is nothing.

        Raises:
            ModbusConnectionError: the other side closed, or the port is gone.
        """

    @abstractmethod
    def send(self, adus: list[bytes], now: float) -> None:
        """
        Send as much as goes at once; `has_unsent` and `resume_at` tell of a rest.

        Raises:
            ModbusConnectionError: it is gone.
        """

    def go_on(self, now: float) -> None:  # noqa: B027  # most ports have sent all
        """Send what is left. Raises ModbusConnectionError."""

    def discard_input(self) -> None:  # noqa: B027  # on a network each byte is somebody's
        """Throw away what has come."""

    def acknowledge(self) -> None:  # noqa: B027  # only TCP does
        """Let the system acknowledge what was received at once, so that more is sent."""

    @abstractmethod
    def close(self) -> None:
        """Put the line back as it was and close. Any number of times."""

    @abstractmethod
    def abandon(self) -> None:
        """Forget the descriptor without a trace on the line: it is a parent process's."""


def lost(error: OSError) -> ModbusConnectionError:
    """Return the error for a port that is gone, with the words of the system."""
    made = ModbusConnectionError(error.strerror or str(error), errno=error.errno)
    made.__cause__ = error
    return made
