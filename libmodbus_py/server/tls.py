"""
Modbus Security at the server's end: a session inside TLS, and the role of the client.

The handshakes of all connections wait in one line, and one step of one of them is done at a
time, between the turns of established connections: a step takes up to a millisecond.
"""

from __future__ import annotations

import asyncio
import ssl
from typing import NamedTuple

from ..device.authorization import LimitedLog
from ..ports.trace import Trace
from ..protocol.errors import FrameError
from ..protocol.logs import HarmlessLogger
from ..security.certificates import (
    CertificateHolder,
    describe,
    holder_of,
    in_words,
    mentions_role,
    role_of,
)
from ..security.files import Acceptance
from ..security.security import Security
from ..security.tunnel import Records, Tunnel
from .audit import Audit
from .limits import Limits, ServerStatistics, host_of
from .peer import READ_BYTES, Peer
from .service import UNREAD, MakeSession, Session, SessionState

logger: HarmlessLogger = HarmlessLogger(__name__)

# The number of unfinished handshakes; each takes about 50 kB. With one more, the oldest is
# given up, of the address that has most.
HALF_OPEN = 1000


class CertificateOwner(NamedTuple):
    """A certificate that is described only in a line that is logged: that takes a while."""

    certificate: bytes

    def __str__(self) -> str:
        return f": {describe(self.certificate)}" if self.certificate else ""


class Handshakes:
    """The handshakes of a server, and the checks of the certificates of open connections."""

    def __init__(
        self,
        security: Security,
        limits: Limits,
        statistics: ServerStatistics,
        auditor: Audit | None = None,
        log: LimitedLog | None = None,
    ) -> None:
        security.check_server()
        self.log: LimitedLog = log or LimitedLog(logger)
        self.security = security
        self.timeout: float = limits.handshake_timeout
        self._interval = limits.certificate_interval
        self.statistics = statistics
        self.auditor = auditor
        self._own = security.own
        self.loop: asyncio.AbstractEventLoop = asyncio.get_running_loop()
        # By address, in the order in which they began.
        self._half_open: dict[str, dict[TlsSession, None]] = {}
        self._count = 0
        # By address, in the order in which they take their steps.
        self._line: dict[str, dict[TlsSession, None]] = {}
        self._next_step: asyncio.Handle | None = None
        # Those whose certificates are checked.
        self.established: dict[TlsSession, None] = {}
        self._next_check: asyncio.TimerHandle | None = None
        self._place = ""

    def open(self, place: str) -> None:
        """Check certificates from now on; `place`: the endpoint, for statistics."""
        self._place = place
        self._check_certificates()

    def close(self) -> None:
        self.statistics.certificate_ends.pop(self._place, None)
        if self._next_check is not None:
            self._next_check.cancel()
            self._next_check = None

    def begin(self, session: TlsSession) -> Tunnel:
        """Return the tunnel of a connection that has sent its first bytes."""
        if self._count >= HALF_OPEN:
            self.statistics.closed_for_others += 1
            most = max(self._half_open.values(), key=len)
            next(iter(most)).give_up()
        self._half_open.setdefault(session.host, {})[session] = None
        self._count += 1
        return self.security.to_client()

    def end(self, session: TlsSession) -> None:
        self._count -= _removed(self._half_open, session)
        _removed(self._line, session)

    def _check_certificates(self) -> None:
        self._next_check = self.loop.call_later(self._interval, self._check_certificates)
        security = self.security
        security.warn_of_end()
        if security.own != self._own and self.auditor is not None:
            self.auditor.note_own("renewed", self._place, holder_of(security.own))
        self._own = security.own
        if security.ends is not None:
            self.statistics.certificate_ends[self._place] = security.ends
        for session in list(self.established):
            session.check_certificate()

    def line_up(self, session: TlsSession) -> None:
        """Let a session take a step in its turn."""
        self._line.setdefault(session.host, {})[session] = None
        session.follow()
        if self._next_step is None:
            self._next_step = self.loop.call_soon(self._step)

    def is_lined_up(self, session: TlsSession) -> bool:
        return session in self._line.get(session.host, ())

    def _step(self) -> None:
        self._next_step = None
        host = next(iter(self._line), None)
        if host is not None:
            queue = self._line.pop(host)
            session = next(iter(queue))
            del queue[session]
            if queue:
                self._line[host] = queue  # its next step comes after those of the other addresses
            if self._line:
                self._next_step = self.loop.call_soon(self._step)
            session.take_step()


def _removed(places: dict[str, dict[TlsSession, None]], session: TlsSession) -> bool:
    """Remove a session; return False if it was not there."""
    sessions = places.get(session.host, {})
    if session not in sessions:
        return False
    del sessions[session]
    if not sessions:
        del places[session.host]
    return True


class TlsSession:
    """A session within TLS: decrypts for the session inside, whose channel it is, and encrypts."""

    __slots__ = (
        "_acceptance", "_handshakes", "_has_more", "_inner", "_make", "_records", "_timer",
        "_tunnel", "_wire", "address", "holder", "host", "role", "trace",
    )  # fmt: skip

    def __init__(self, wire: Peer, handshakes: Handshakes, make: MakeSession) -> None:
        self.address: str = wire.address
        self.host: str = host_of(wire.address)  # what its handshake counts for
        self.trace: Trace | None = None
        self.role: str | None = None
        self.holder: CertificateHolder | None = None
        self._wire = wire
        self._handshakes = handshakes
        self._make = make
        self._tunnel: Tunnel | None = None
        self._records = Records()
        self._inner: Session | None = None
        self._has_more = False  # True if bytes were received that were not processed yet
        self._timer = handshakes.loop.call_later(handshakes.timeout, self._be_late)

    # --- the session of the connection --------------------------------------------------------

    @property
    def state(self) -> SessionState:
        inner = self._inner
        if inner is None:
            # The handshake has a timeout of its own.
            is_lined_up = self._handshakes.is_lined_up(self)
            return SessionState.HELD if is_lined_up else SessionState.HANDSHAKE
        state = inner.state
        if state in (SessionState.BEHIND, SessionState.HELD):
            return state
        if self._has_more:
            return SessionState.BEHIND
        return SessionState.UNFINISHED if self._records.is_midway else state

    def receive(self, data: bytes) -> int:
        tunnel, inner = self._tunnel, self._inner
        if tunnel is None:
            handshakes = self._handshakes
            self._acceptance = Acceptance(lambda: handshakes.security.loaded)
            tunnel = self._tunnel = handshakes.begin(self)
        is_one = False
        if data:
            tunnel.feed(data)
            is_one = self._records.follow(data)
        if inner is not None:
            if not data and inner.state is SessionState.BEHIND:
                return inner.receive(b"")
            return self._take(tunnel, inner, is_one=is_one)
        self._handshakes.line_up(self)
        return 0

    def end(self) -> None:
        self._has_more = False
        self._records = Records()
        if self._inner is not None:
            self._inner.end()

    def close(self) -> None:
        self._stop()
        if self._inner is not None:
            self._inner.close()
            self._inner = None
            if self._tunnel is not None:
                self._tunnel.end()
                self._wire.write(self._tunnel.outgoing())
        self._tunnel = None

    def _stop(self) -> None:
        self._has_more = False
        self._timer.cancel()
        self._handshakes.end(self)
        self._handshakes.established.pop(self, None)

    # --- the handshake --------------------------------------------------------------------------

    def take_step(self) -> None:
        """Continue the handshake as far as the received bytes allow."""
        assert self._tunnel is not None
        try:
            self._shake_hands(self._tunnel)
        except Exception:  # a defect of ours must not stop the handshakes of others
            logger.exception("%s: connection closed", self.address)
            self._finish()
        self._wire.follow()

    def _shake_hands(self, tunnel: Tunnel) -> None:
        certificate = b""
        try:
            is_done = tunnel.handshake()
            refusal = self._check(tunnel) if is_done else None
        except ssl.SSLError as error:
            is_done, refusal = False, in_words(error)
        if refusal is not None:
            certificate = tunnel.certificate
            tunnel.end()  # unless OpenSSL sent an alert: Python cannot send one of its own
        if answer := tunnel.outgoing():
            self._wire.write(answer)
        if refusal is not None:
            self._refuse(refusal, certificate)
        elif is_done:
            self._open(tunnel)

    def _check(self, tunnel: Tunnel) -> str | None:
        """Store the role of an accepted certificate; return the reason for a refusal, or None."""
        certificate = tunnel.certificate
        if (refusal := self._handshakes.security.refusal(tunnel)) is not None:
            return refusal
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
        self._acceptance.begin(tunnel)
        if (auditor := self._handshakes.auditor) is not None:
            self.holder = holder_of(tunnel.certificate)
            auditor.note_peer("logon", self.address, "ok", self.holder, self.role)
        self._handshakes.established[self] = None
        self._inner = self._make(self)
        self._has_more = tunnel.has_more

    def _refuse(self, reason: str, certificate: bytes) -> None:
        self._handshakes.statistics.handshakes_refused += 1
        if (auditor := self._handshakes.auditor) is not None:
            holder = holder_of(certificate) if certificate else None
            auditor.note_peer("handshake", self.address, reason, holder)
        message, whose = "%s: TLS refused: %s%s", CertificateOwner(certificate)
        self._handshakes.log.warning(message, self.address, reason, whose, reason=reason)
        self._finish()

    def check_certificate(self) -> None:
        """Close the connection if the client's certificate has expired or is not trusted."""
        if (reason := self._acceptance.refusal()) is not None:
            self._handshakes.statistics.closed_untrusted += 1
            if (auditor := self._handshakes.auditor) is not None:
                auditor.note_peer("ended", self.address, reason, self.holder, self.role)
            whose = "" if self.holder is None else f": {self.holder.subject}"
            message = "%s: TLS ended: %s%s"
            self._handshakes.log.warning(message, self.address, reason, whose, reason=reason)
            self._finish()

    def _be_late(self) -> None:
        self._handshakes.statistics.closed_slow += 1
        message = "%s: closed: no TLS handshake within %g s (handshake_timeout)"
        self._handshakes.log.warning(message, self.address, self._handshakes.timeout)
        self._finish()

    def give_up(self) -> None:
        """Close the connection, because other handshakes need the room."""
        message = "%s: closed to make room for another TLS handshake (at most %d at a time)"
        self._handshakes.log.warning(message, self.address, HALF_OPEN)
        self._finish()

    def _finish(self) -> None:
        self._stop()
        self._wire.end()

    # --- requests -------------------------------------------------------------------------------

    def _take(self, tunnel: Tunnel, inner: Session, *, is_one: bool) -> int:
        """Pass a slice of the received bytes on; `is_one`: one record, with nothing behind it."""
        requests, room = 0, READ_BYTES
        self._has_more = False
        try:
            while data := tunnel.receive(room):
                requests += inner.receive(data)
                if is_one or not tunnel.has_more:
                    return requests
                room -= len(data)
                if room <= 0 or inner.state in UNREAD:
                    self._has_more = True
                    self._wire.follow()
                    return requests
        except ssl.SSLError as error:
            self._fail(error)
        except FrameError as error:  # not to the wire, because requests before it count
            self._be_out_of_step(str(error))
        else:
            if answer := tunnel.outgoing():  # a change of keys
                self._wire.write(answer)
            if data is not None:  # the client sends no more requests, but may still read answers
                self._finish()
        return requests

    def _fail(self, error: ssl.SSLError) -> None:
        if self._tunnel is not None:
            self._wire.write(self._tunnel.outgoing())  # the alert
        self._tunnel = None
        self._be_out_of_step(in_words(error))

    def _be_out_of_step(self, reason: str) -> None:
        self._handshakes.log.warning("%s: connection closed: %s", self.address, reason)
        self._handshakes.statistics.closed_out_of_step += 1
        self._finish()

    # --- for the session inside ---------------------------------------------------------------

    def write(self, data: bytes) -> None:
        tunnel = self._tunnel
        if tunnel is None:
            return  # the connection ended while the answer was made
        try:
            tunnel.send(data)
        except ssl.SSLError as error:
            self._fail(error)
        else:
            self._wire.write(tunnel.outgoing())

    def follow(self) -> None:
        self._wire.follow()

    def hang_up(self) -> bool:
        self._finish()
        return True
