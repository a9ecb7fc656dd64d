"""
Local echo at a TCP endpoint with frames of a line: a converter passes on what its line returns.
"""

from __future__ import annotations

import asyncio
from typing import Protocol

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
LONGEST_WAY = 0.15


class _Receive(Protocol):
    """See `Session`."""

    def __call__(self, data: bytes) -> int: ...


class _Write(Protocol):
    """See `Channel`."""

    def __call__(self, data: bytes) -> None: ...


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
        # The end of an answer on trial, what is to follow it, and when it leaves.
        self._held = self._behind = b""
        self._trial: asyncio.TimerHandle | None = None
        self._session = endpoint.make(self)
        self.receive: _Receive = self._receive
        self.write: _Write = self._write

    # --- the session ----------------------------------------------------------------------

    @property
    def state(self) -> SessionState:
        return self._session.state

    def _receive(self, data: bytes) -> int:
        rest = self._without_echo(data) if data else data
        return self._session.receive(rest) if rest or not data else 0

    def _without_echo(self, data: bytes) -> bytes:
        if self._watch.has_echo:
            return self._awaited.without(data)
        rest = self._watch.without_echo(data, self._loop.time())
        if rest:
            self._written = b""
        self._note_verdict()
        return rest

    def _note_verdict(self) -> None:
        """Look no longer at what comes and goes on a connection without an echo."""
        has_echo = self._watch.has_echo
        if has_echo is False:
            self.receive, self.write = self._session.receive, self._channel.write
        elif has_echo:
            self._written = b""
            self._endpoint.note_echo()
        if self._held and not self._watch.is_trying:
            self._send_held()

    def end(self) -> None:
        if self._held:
            self._end_trial()
        self._session.end()

    def close(self) -> None:
        if self._trial is not None:
            self._trial.cancel()
            self._trial = None
        self._session.close()

    # --- the channel ----------------------------------------------------------------------

    @property
    def trace(self) -> Trace | None:
        return self._channel.trace

    def _write(self, data: bytes) -> None:
        if self._held:
            self._behind += data
            return
        if self._watch.has_echo:
            self._awaited.expect(data)
        elif self._watch.has_echo is None:
            self._written += data
            self._held = self._watch.sent(self._written, self._loop.time())
            if self._held:
                data = data[: -len(self._held)]
                self._trial = self._loop.call_later(self._watch.gap, self._end_trial)
        self._channel.write(data)

    def _end_trial(self) -> None:
        heard = self._watch.end_trial(self._loop.time())
        self._note_verdict()
        if heard:
            self._written = b""
            self._session.receive(heard)
            self._channel.follow()

    def _send_held(self) -> None:
        """Send what was held back for a trial, which is over."""
        if self._trial is not None:
            self._trial.cancel()
            self._trial = None
        held, self._held = self._held, b""
        behind, self._behind = self._behind, b""
        if self._watch.has_echo:
            self._awaited.expect(held)
        self._channel.write(held)
        if behind:
            self.write(behind)

    def follow(self) -> None:
        self._channel.follow()

    def hang_up(self) -> bool:
        return self._channel.hang_up()
