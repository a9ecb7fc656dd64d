"""
What an endpoint needs to know of who answers: sessions, and what makes them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from ..ports.endpoint import Endpoint
from .limits import ServerStatistics

__all__ = ["ENDS", "Later", "Link", "MakeSession", "Service", "Session"]

# What a hook raises to end the program; whatever else is an answer, or our mistake.
ENDS = (SystemExit, KeyboardInterrupt)


class Link(Protocol):
    """
    The connection that a session belongs to.

    Attributes:
        address: who asks: "192.0.2.7:51234", or the serial port.
        role: what the certificate of the peer says of it, if anything.
    """

    address: str
    role: str | None

    def write(self, data: bytes) -> None:
        """Send answers, in the order of the calls."""

    def follow(self) -> None:
        """Look again whether the session is behind, or waiting."""

    def hang_up(self) -> bool:
        """Close the connection when what was written is sent; False if there is none."""
        ...


class Session(Protocol):
    """What one connection or one port received, and the answers to it."""

    @property
    def takes_requests(self) -> bool:
        """Whether what comes is requests, and no handshake."""
        ...

    @property
    def is_unfinished(self) -> bool:
        """Whether a frame has begun whose end nothing but its last byte can tell."""
        ...

    @property
    def is_behind(self) -> bool:
        """Whether something was received that is still to be looked at: by `receive(b"")`."""
        ...

    @property
    def is_waiting(self) -> bool:
        """Whether the next bytes can wait, for it is behind, or an answer is kept back."""
        ...

    @property
    def is_owing(self) -> bool:
        """Whether it will write an answer to what it has received, but not now."""
        ...

    def receive(self, data: bytes) -> int:
        """
        Take received bytes, write the answers, give how many requests there were.

        While it is behind none come; a call without bytes goes on where the last one stopped.

        Raises:
            FrameError: the stream must be closed; there were no requests this time.
        """
        ...

    def end(self) -> None:
        """Nothing more comes; who asked may be gone, or still listen."""

    def close(self) -> None: ...


MakeSession = Callable[[Link], Session]

Later = Callable[[Callable[[], None]], None]
"""Has a function called when all connections have been read, before answers are sent."""


class Service(Protocol):
    """Who answers at the endpoints of a server."""

    def sessions(
        self, endpoint: Endpoint, statistics: ServerStatistics, later: Later | None = None
    ) -> MakeSession:
        """
        Give what makes the session of each connection, datagram or port of an endpoint.

        Args:
            statistics: where it is counted.
            later: of an endpoint whose connections are read together; else None.
        """
        ...
