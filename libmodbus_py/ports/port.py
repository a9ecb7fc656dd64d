"""
The port of a client: how it is made, opened, lost and opened again, and left to a parent process.
"""

from __future__ import annotations

import contextlib
import select
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

from ..protocol.errors import ModbusConnectionError, ModbusError
from ..system import call_in_children
from .schemes import TRANSPORTS
from .waiting import Steps, Waker, of_system

if TYPE_CHECKING:
    import logging

    from ..protocol.logs import HarmlessLogger
    from ..security.security import GivenContext, Security
    from .endpoint import Endpoint

# fmt: off
__all__ = [
    "RECEIVED_BYTES", "REOPEN_AFTER", "Outage", "Port", "PortSettings", "Silence",
    "abandoned_in_children", "lost", "make_port",
]
# fmt: on

RECEIVED_BYTES = 16_384
"""Bytes received at once: the answers to all requests usually in flight, in one turn of a loop."""

# Seconds between two attempts to open a port that is gone.
REOPEN_AFTER = 1.0


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

    @property
    def certificate(self) -> bytes | None:
        """The client's own certificate in DER; None without TLS."""
        return None

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


class PortSettings(Protocol):
    """
    The options of a client that concern its port.

    Attributes:
        keepalive: seconds of silence after which TCP probes the connection; None for never.
        security: the certificates, for TLS.
    """

    @property
    def keepalive(self) -> float | None: ...
    @property
    def security(self) -> Security | GivenContext | None: ...


def make_port(endpoint: Endpoint, settings: PortSettings) -> Port:
    """
    Return the port of a client, closed.

    Raises:
        TypeError, ValueError: a setting that this transport cannot have, or of the wrong range.
    """
    rules = TRANSPORTS[endpoint.transport]
    if settings.security is not None and not rules.is_secure:
        raise ValueError(f"security is for tls:// only, not for {endpoint.scheme}://")
    module, _, name = rules.port_class.partition(".")
    made: Port = getattr(import_module(f".{module}", __package__), name).of(endpoint, settings)
    return made


class Outage:
    """
    Logs once that a port or a connection is lost, and once that it is open again.

    Args:
        log: of the part that uses it.
        name: of the port or the connection, for the log.

    Attributes:
        is_on: True while it is lost.
    """

    def __init__(self, log: logging.Logger | HarmlessLogger, name: object) -> None:
        self.is_on: bool = False
        self._log = log
        self._name = name

    def begin(self, error: ModbusError) -> None:
        """Log that it is lost, or cannot be opened."""
        if not self.is_on:
            self.is_on = True
            self._log.warning("%s: %s; trying again", self._name, error)

    def end(self) -> None:
        """Log that it is open again."""
        if self.is_on:
            self.is_on = False
            self._log.warning("%s: open again", self._name)

    def try_to_end(self, reopen: Callable[[], object]) -> bool:
        """Open it again; return False if it is still gone. Call it every `REOPEN_AFTER` seconds."""
        try:
            reopen()
        except ModbusConnectionError:
            return False
        self.end()
        return True


class Abandoned(Protocol):
    """An object with descriptors, such as a server or the driver of a client."""

    def abandon(self) -> None:
        """Close the descriptors in a forked child, without an effect on loops, epolls or lines."""
        ...


# While a forked child has a copy of a descriptor, no peer sees the end of a connection that the
# parent closes, and no port is free again.
_abandoned: weakref.WeakSet[Abandoned] = weakref.WeakSet()


def abandoned_in_children(owner: Abandoned) -> None:
    """Call `abandon` of an object in every child that is forked while it exists."""
    _abandoned.add(owner)


def _abandon_all() -> None:
    for owner in list(_abandoned):
        # Not logged: another thread of the parent may have held the locks of the log.
        with contextlib.suppress(Exception):
            owner.abandon()


call_in_children(_abandon_all)
