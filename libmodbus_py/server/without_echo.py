"""
Local echo at a TCP endpoint with frames of a line: a converter passes on what its line returns.
"""

from __future__ import annotations

import asyncio

from ..ports.endpoint import Endpoint
from ..ports.trace import Trace
from ..protocol.framing import Framing
from ..protocol.logs import HarmlessLogger
from ..protocol.returned import AwaitedEcho
from ..security.describing import CertificateHolder
from .echo import EchoWatch
from .limits import ServerStatistics
from .service import Channel, MakeSession, Session, SessionState

__all__ = ["WithoutEcho"]

logger: HarmlessLogger = HarmlessLogger(__name__)

# An answer that comes back after this many seconds is a request that a client repeats.
LONGEST_WAY = 1.0


class WithoutEcho:
    """
    Makes the sessions of one endpoint, which do not see their own answers.

    Args:
        make: makes the sessions that answer.
        statistics: where connections with an echo are counted.
    """

    def __init__(self, endpoint: Endpoint, make: MakeSession, statistics: ServerStatistics) -> None:
        self.framing: Framing = endpoint.framing
        self.make: MakeSession = make
        self._endpoint = endpoint
        self._statistics = statistics
        self._was_told = False

    def __call__(self, channel: Channel) -> Session:
        """Return the session of a connection."""
        return _WatchedSession(self, channel)

    def note_echo(self) -> None:
        """Count a connection that returns what is sent; log the first one."""
        self._statistics.echoes += 1
        if not self._was_told:
            self._was_told = True
            text = "%s: what is sent comes back (local echo), and is dropped"
            logger.warning(text, self._endpoint)


class _WatchedSession:
    """The session of a connection, and the channel of the session that answers within it."""

    def __init__(self, endpoint: WithoutEcho, channel: Channel) -> None:
        self.address: str = channel.address
        self.role: str | None = channel.role
        self.holder: CertificateHolder | None = channel.holder
        self._endpoint = endpoint
        self._channel = channel
        self._loop = asyncio.get_running_loop()
        self._watch = EchoWatch(endpoint.framing, 0.0, 0.0, LONGEST_WAY)
        self._awaited = AwaitedEcho(b"")
        self._written = b""
        self._session = endpoint.make(self)

    # --- the session ----------------------------------------------------------------------

    @property
    def state(self) -> SessionState:
        return self._session.state

    def receive(self, data: bytes) -> int:
        if not data or self._watch.has_echo is False:
            return self._session.receive(data)
        rest = self._without_echo(data)
        return self._session.receive(rest) if rest else 0

    def _without_echo(self, data: bytes) -> bytes:
        if self._watch.has_echo:
            return self._awaited.without(data)
        rest = self._watch.without_echo(data, self._loop.time())
        trial, self._watch.trial = self._watch.trial, b""
        if rest or trial:
            self._written = b""
        if self._watch.has_echo:
            self._written = b""
            self._endpoint.note_echo()
        if trial:
            self.write(trial)
        return rest

    def end(self) -> None:
        self._session.end()

    def close(self) -> None:
        self._session.close()

    # --- the channel ----------------------------------------------------------------------

    @property
    def trace(self) -> Trace | None:
        return self._channel.trace

    def write(self, data: bytes) -> None:
        if self._watch.has_echo:
            self._awaited.expect(data)
        elif self._watch.has_echo is None:
            self._written += data
            self._watch.sent(self._written, self._loop.time())
        self._channel.write(data)

    def follow(self) -> None:
        self._channel.follow()

    def hang_up(self) -> bool:
        return self._channel.hang_up()
