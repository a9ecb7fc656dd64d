"""
The interface between endpoints and devices or gateways: sessions, and services that make them.
"""

from __future__ import annotations

import contextlib
import enum
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Protocol

from ..ports.endpoint import Endpoint
from ..ports.hosts import reason
from ..ports.trace import Trace
from ..protocol.errors import ModbusConnectionError
from .limits import ServerStatistics

if TYPE_CHECKING:
    from ..security.certificates import CertificateHolder

# Raised by a hook to end the program; any other exception is an answer, or a defect of ours.
ENDS = (SystemExit, KeyboardInterrupt)


TURN_EVENTS = 128
"""Connections that are accepted or read, or datagrams that are answered, in one turn: the clients
of other endpoints wait meanwhile."""


class Channel(Protocol):
    """
    The connection, datagram or port that a session belongs to.

    Attributes:
        address: address of the client: "192.0.2.7:51234", or the serial port.
        role: the role in the client's certificate, if any.
        holder: the holder of this certificate, if any.
        trace: called with every ADU; None if tracing is off.
    """

    address: str
    role: str | None
    holder: CertificateHolder | None
    trace: Trace | None

    def write(self, data: bytes) -> None:
        """Send answers, in the order of the calls."""

    def follow(self) -> None:
        """Check the state of the session again, because it may have changed."""

    def hang_up(self) -> bool:
        """Close the connection when all answers are sent; return False if there is none."""
        ...


class SessionState(enum.Enum):
    """
    The state of a session; of several that apply, the first in this order.

    Attributes:
        HANDSHAKE: received bytes that are not requests yet.
        BEHIND: a call of `receive(b"")`, because not all that was received has been looked at.
        HELD: the time at which a delayed answer is sent; until then nothing should be received.
        UNFINISHED: the rest of a frame that only its last byte can end.
        OWING: an answer that it will write to what was received; meanwhile more may be received.
        READING: requests.
    """

    HANDSHAKE = "handshake"
    BEHIND = "behind"
    HELD = "held"
    UNFINISHED = "unfinished"
    OWING = "owing"
    READING = "reading"


UNREAD = (SessionState.BEHIND, SessionState.HELD)
"""The states in which a session is given no bytes."""


class Session(Protocol):
    """Answers the bytes that one connection, datagram or port receives."""

    @property
    def state(self) -> SessionState:
        """The present state; after `end`, OWING or READING."""
        ...

    def receive(self, data: bytes) -> int:
        """
        Take received bytes, write the answers, and return the number of requests.

        While it is BEHIND or HELD it is given none; b"" makes it go on where it stopped.

        Raises:
            FrameError: the stream must be closed; there were no requests this time.
        """
        ...

    def end(self) -> None:
        """Note that nothing more is received, and drop bytes that were not searched."""

    def close(self) -> None:
        """Drop everything, delayed answers included."""


MakeSession = Callable[[Channel], Session]

Later = Callable[[Callable[[], None]], None]
"""Function that calls another when all connections have been read, before answers are sent."""


class Service(Protocol):
    """Makes the sessions that answer at the endpoints of a server."""

    def sessions(
        self, endpoint: Endpoint, statistics: ServerStatistics, later: Later | None = None
    ) -> MakeSession:
        """
        Return a function that makes the session of each connection, datagram or port; `later` is
        for connections that are read together.
        """
        ...


@contextlib.contextmanager
def explained(what: str) -> Iterator[None]:
    """Convert any other OSError, as of epoll, to a ModbusConnectionError that names the cause."""
    try:
        yield
    except ModbusConnectionError:
        raise
    except OSError as error:
        raise ModbusConnectionError(f"{what}: {reason(error)}", errno=error.errno) from error
