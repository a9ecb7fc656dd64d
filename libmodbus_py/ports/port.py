"""
The port of a client: how it is made, opened, lost and opened again, and left to a parent process.
"""

from __future__ import annotations

import contextlib
import select
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

from ..protocol.errors import ModbusConnectionError, ModbusError
from ..system import call_in_children
from .schemes import TRANSPORTS, Transport
from .waiting import Steps, Waker, of_system

if TYPE_CHECKING:
    import logging

    from ..protocol.logs import HarmlessLogger
    from .endpoint import Endpoint
    from .options import ConnectionOptions

RECEIVED_BYTES = 16_384
"""Bytes received at once: the answers to all requests usually in flight, in one turn of a loop."""

MAX_UNASKED_BYTES = 1 << 16
"""Bytes without an answer after which a connection counts as flooded."""

# Seconds between two attempts to open a missing port.
REOPEN_AFTER = 1.0


class Silence:
    """The silence that a line needs before a frame is sent; times are those of time.monotonic()."""

    def __init__(self, seconds: float = 0.0, character: float = 0.0, turn: float = 0.0) -> None:
        self.seconds = seconds
        self.character = character  # seconds for one byte on the line
        self.over_at: float = 0.0  # from then on frames may be sent
        self._turn = turn  # seconds before and after each frame, for turning the line round
        self._turned_at = 0.0

    def heard(self, now: float) -> None:
        self.over_at = max(now + self.seconds, self._turned_at)

    def sent(self, size: int, now: float) -> None:
        """Note bytes that were passed to the driver; the last one leaves later."""
        gone_at = now + size * self.character + 2 * self._turn
        self.over_at = gone_at + self.seconds
        self._turned_at = gone_at if self._turn else 0.0


class Port(ABC):
    """A TCP connection, a UDP socket or a serial port; nothing here waits."""

    descriptor: int = -1  # -1 while closed
    context: Any = None  # of libmodbus, where that opens the port
    silence: Silence
    resume_at: float | None = None  # when `go_on` should be called (time.monotonic)
    has_unsent = False  # whether `go_on` should be called once the port takes bytes again
    has_input: Callable[[], object]  # true if there are bytes, or the end of the connection

    @abstractmethod
    def opening(self, deadline: float) -> Steps[None]:
        """Open the port, or raise ModbusConnectionError with errno, as all methods do."""

    def waker(self) -> Waker:
        return Waker()

    @property
    def certificate(self) -> bytes | None:
        """The client's own certificate in DER; None without TLS."""
        return None

    def _watch(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLIN)
        self.has_input = partial(self._poll.poll, 0)

    @abstractmethod
    def receive(self) -> list[bytes]:
        """Return received bytes, one item for each datagram; an empty list if there are none."""

    @abstractmethod
    def send(self, adus: list[bytes], now: float) -> None:
        """Send as much as possible; `has_unsent` or `resume_at` is set if a rest remains."""

    def go_on(self, now: float) -> None:  # noqa: B027  # most ports have sent all
        """Send the rest."""

    def discard_input(self) -> None:  # noqa: B027  # on a network no byte is noise
        """Discard received bytes."""

    def acknowledge(self) -> None:  # noqa: B027  # only TCP does
        """Make the system acknowledge received bytes at once, so that the peer sends more."""

    @abstractmethod
    def close(self) -> None:
        """Restore the settings of the line and close the port; may be called repeatedly."""

    def shut(self) -> None:
        """Close the port for good: a client that listens gives up its address."""
        self.close()

    @abstractmethod
    def abandon(self) -> None:
        """Close the descriptor without an effect on the line, which belongs to a parent process."""


def port_class(transport: Transport) -> Any:
    """
    Return the class of the ports of a transport.

    Each is imported when it is first needed: ssl alone, which TLS needs, takes longer than the rest
    of a client, and a serial port needs libmodbus.
    """
    module, _, name = TRANSPORTS[transport].port_class.partition(".")
    return getattr(import_module(f".{module}", __package__), name)


def make_port(endpoint: Endpoint, settings: ConnectionOptions) -> Port:
    """
    Return the port of a client, closed.

    Args:
        endpoint: the endpoint to connect to, with the options of its URL.
        settings: the checked options of the client; a port reads `keepalive` and `security`.

    Raises:
        TypeError, ValueError: a setting of the endpoint is wrong, or not for its transport.
    """
    if settings["security"] is not None and not endpoint.is_secure:
        raise ValueError(f"security is for tls:// only, not for {endpoint.scheme}://")
    if settings["source"] is not None and (endpoint.has_path or endpoint.is_listening):
        raise ValueError(f"source is for hosts, not for {endpoint.scheme}://")
    if settings["greeting"] is not None and not endpoint.is_listening:
        raise ValueError(f"greeting is for listen+tcp://, not for {endpoint.scheme}://")
    port: Port = port_class(endpoint.transport).of(endpoint, settings)
    return port


def lost(error: OSError) -> ModbusConnectionError:
    """Return the error for a port that is gone, with the words of the system."""
    failure = ModbusConnectionError(of_system(error).strerror or str(error), errno=error.errno)
    failure.__cause__ = error
    return failure


class Outage:
    """Logs once that a port or a connection is lost, and once that it is open again."""

    def __init__(self, log: logging.Logger | HarmlessLogger, name: object) -> None:
        self.is_on: bool = False
        self._log = log
        self._name = name

    def begin(self, error: ModbusError) -> None:
        """Log that the port is lost, or cannot be opened."""
        if not self.is_on:
            self.is_on = True
            self._log.warning("%s: %s; trying again", self._name, error)

    def end(self) -> None:
        """Log that the port is open again."""
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


class DescriptorOwner(Protocol):
    """An object with descriptors, such as a server or the driver of a client."""

    def abandon(self) -> None:
        """Close the descriptors in a forked child, without an effect on loops, epolls or lines."""


# While a forked child has a copy of a descriptor, no peer sees the end of a connection that the
# parent closes, and no port is free again.
_abandoned: weakref.WeakSet[DescriptorOwner] = weakref.WeakSet()

abandoned_in_children: Callable[[DescriptorOwner], None] = _abandoned.add
"""Call `abandon` of an object in every child that is forked while it exists."""


def _abandon_all() -> None:
    for owner in list(_abandoned):
        # Not logged: another thread of the parent may have held the locks of the log.
        with contextlib.suppress(Exception):
            owner.abandon()


call_in_children(_abandon_all)
