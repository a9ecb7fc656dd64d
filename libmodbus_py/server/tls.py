"""
Modbus Security at the server's end: a session inside TLS, and the role of who asks.

The handshakes of all connections wait in one line, and one step of one of them is done at a
time, between the turns of those that are through: a step takes up to a millisecond.
"""

from __future__ import annotations

import asyncio
import logging
import ssl
import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

from ..security.role import mentions_role, role_of
from ..security.security import Security
from ..security.tunnel import Tunnel
from .by_frame import Link, Session
from .limits import ServerStatistics

__all__ = ["Handshakes", "TlsSession"]

logger: logging.Logger = logging.getLogger(__name__)

# How many handshakes may have begun and not ended; each takes about 50 kB. One more, and the
# oldest is given up.
HALF_OPEN = 1000

# How much of what one record carries is answered in a turn.
READ_SIZE = 1024


class Wire(Link, Protocol):
    """A connection of its own."""

    def end(self) -> None:
        """Send what is to be sent, and close."""


class Handshakes:
    """
    The handshakes of a server.

    Args:
        security: who the server is, and whom it trusts.
        timeout: seconds that one may take from the connection on.
    """

    def __init__(self, security: Security, timeout: float, statistics: ServerStatistics) -> None:
        security.check_server()
        self.security = security
        self.timeout = timeout
        self.statistics = statistics
        self.loop: asyncio.AbstractEventLoop = asyncio.get_running_loop()
        self._due: deque[TlsSession] = deque()
        self._half_open: dict[TlsSession, None] = {}

    def begin(self, session: TlsSession) -> Tunnel:
        """Make the tunnel of a connection that has sent something."""
        if len(self._half_open) >= HALF_OPEN:
            self.statistics.closed_for_others += 1
            next(iter(self._half_open)).give_up()
        self._half_open[session] = None
        return self.security.to_client()

    def end(self, session: TlsSession) -> None:
        """It is over, well or not. Any number of times."""
        self._half_open.pop(session, None)

    def line_up(self, session: TlsSession) -> None:
        """Give it its turn after the others."""
        if not self._due:
            self.loop.call_soon(self._step)
        self._due.append(session)

    def _step(self) -> None:
        self._due.popleft().have_turn()
        if self._due:
            self.loop.call_soon(self._step)


class TlsSession:
    """
    What one connection received, taken out of TLS for the session inside.

    Args:
        wire: the connection.
        handshakes: those of the server.
        make: makes the session inside, when it is known who asks.

    Attributes:
        address, role: who asks, for the session inside.
        is_behind: whether it has its turn, or something within is still to be looked at.
        is_waiting: whether no more should be read now.
    """

    # fmt: off
    __slots__ = (
        "_handshakes", "_has_turn", "_inner", "_is_lined_up", "_is_midway", "_is_over",
        "_make", "_timer", "_tunnel", "_wire", "address", "role",
    )
    # fmt: on

    def __init__(self, wire: Wire, handshakes: Handshakes, make: Callable[[Link], Session]) -> None:
        self.address: str = wire.address
        self.role: str | None = None
        self._wire = wire
        self._handshakes = handshakes
        self._make = make
        self._tunnel: Tunnel | None = None
        self._inner: Session | None = None
        self._has_turn = self._is_lined_up = self._is_midway = self._is_over = False
        self._timer = handshakes.loop.call_later(handshakes.timeout, self._be_late)

    @property
    def is_behind(self) -> bool:
        return self._has_turn or (self._inner is not None and self._inner.is_behind)

    @property
    def is_waiting(self) -> bool:
        if self._is_lined_up or self._has_turn:
            return True
        return self._inner is not None and self._inner.is_waiting

    @property
    def is_unfinished(self) -> bool:
        # The handshake has a time of its own.
        return self._inner is not None and (self._is_midway or self._inner.is_unfinished)

    # --- the session of the connection --------------------------------------------------------

    def receive(self, data: bytes) -> int:
        if self._is_over:
            return 0
        if self._tunnel is None:
            self._tunnel = self._handshakes.begin(self)
        if data:
            self._tunnel.feed(data)
        if self._inner is None:
            return self._get_on(self._tunnel)
        self._has_turn = False
        if self._inner.is_behind:
            requests = self._inner.receive(b"")
            self._has_turn = self._tunnel.has_more
            return requests
        return self._take(self._tunnel, self._inner)

    def close(self) -> None:
        self._timer.cancel()
        self._handshakes.end(self)
        if self._inner is not None:
            self._inner.close()
            self._inner = None
            if self._tunnel is not None and not self._is_over:
                self._tunnel.end()
                self._wire.write(self._tunnel.outgoing())
        self._tunnel = None
        self._is_over = True

    # --- the handshake --------------------------------------------------------------------------

    def have_turn(self) -> None:
        """Do the next step in the turn of the connection."""
        self._is_lined_up = False
        self._has_turn = not self._is_over
        self._wire.follow()

    def _get_on(self, tunnel: Tunnel) -> int:
        if self._has_turn:
            self._has_turn = False
            self._shake_hands(tunnel)
        elif not self._is_lined_up:
            self._is_lined_up = True
            self._handshakes.line_up(self)
            self._wire.follow()
        return 0 if self._inner is None else self._take(tunnel, self._inner)

    def _shake_hands(self, tunnel: Tunnel) -> None:
        try:
            is_done = tunnel.handshake()
            refusal = self._check(tunnel) if is_done else None
        except ssl.SSLError as error:
            is_done, refusal = False, _reason(error)
        self._wire.write(tunnel.outgoing())
        if refusal is not None:
            self._refuse(refusal)
        elif is_done:
            self._open(tunnel)

    def _check(self, tunnel: Tunnel) -> str | None:
        """Say what is wrong with a certificate that OpenSSL found good, and take its role."""
        certificate = tunnel.certificate
        if not self._handshakes.security.accepts(certificate):
            return "the certificate is none of the pins"
        # OpenSSL looks at the dates when a session begins, not when it is resumed.
        until = tunnel.expires if tunnel.is_resumed else None
        if until is not None and ssl.cert_time_to_seconds(until) < time.time():
            return "the certificate has expired"
        if not mentions_role(certificate):
            return None
        try:
            self.role = role_of(certificate)
        except (ImportError, ValueError) as error:
            return str(error)
        return None

    def _open(self, tunnel: Tunnel) -> None:
        statistics = self._handshakes.statistics
        statistics.handshakes += 1
        statistics.handshakes_resumed += tunnel.is_resumed
        self._timer.cancel()
        self._handshakes.end(self)
        self._inner = self._make(self)

    def _refuse(self, reason: str) -> None:
        self._handshakes.statistics.handshakes_refused += 1
        logger.info("%s: TLS refused: %s", self.address, reason)
        self._finish()

    def _be_late(self) -> None:
        self._handshakes.statistics.closed_slow += 1
        self._finish()

    def give_up(self) -> None:
        """Others need the room."""
        self._finish()

    def _finish(self) -> None:
        self._is_over = True
        self._timer.cancel()
        self._handshakes.end(self)
        self._wire.end()

    # --- requests -------------------------------------------------------------------------------

    def _take(self, tunnel: Tunnel, inner: Session) -> int:
        requests, left = 0, READ_SIZE
        try:
            while data := tunnel.receive(left):
                requests += inner.receive(data)
                left -= len(data)
                if not tunnel.has_more:
                    self._is_midway = False
                    return requests
                if left <= 0 or inner.is_behind:
                    self._has_turn = True
                    self._wire.follow()
                    return requests
        except ssl.SSLError as error:
            logger.debug("%s: connection closed: %s", self.address, _reason(error))
            self._handshakes.statistics.closed_out_of_step += 1
            self._finish()
        else:
            self._is_midway = data is None
            if data is not None:  # it will not ask any more, but may still listen
                self._finish()
        if answer := tunnel.outgoing():  # an alert, or a change of keys
            self._wire.write(answer)
        return requests

    # --- for the session inside ---------------------------------------------------------------

    def write(self, data: bytes) -> None:
        tunnel = self._tunnel
        assert tunnel is not None
        tunnel.send(data)
        self._wire.write(tunnel.outgoing())

    def follow(self) -> None:
        self._wire.follow()


def _reason(error: ssl.SSLError) -> str:
    return (error.reason or str(error)).lower().replace("_", " ")
