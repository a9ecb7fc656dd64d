"""TLS connections: Modbus Security, at the client's end."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import ssl
import time
from typing import TYPE_CHECKING, Any, Self, TypeAlias, TypeVar

from ..protocol.errors import ModbusConnectionError
from ..security.certificates import describe, in_words
from ..security.files import Acceptance
from ..security.security import GivenContext, Security
from ..security.tunnel import Tunnel
from ..system import KEY_REJECTED
from .endpoint import Endpoint
from .port import MAX_UNASKED_BYTES, RECEIVED_BYTES
from .sockets import TcpPort
from .waiting import READ, WRITE, Ready, Steps, of_system, timed_out

ClientSecurity: TypeAlias = Security | GivenContext
Given = TypeVar("Given", bound=ClientSecurity)

if TYPE_CHECKING:
    from .options import ConnectionOptions

# The ends of OpenSSL's reasons for alerts by which the other side refuses our certificate.
OF_OUR_CERTIFICATE = (
    "UNKNOWN_CA", "BAD_CERTIFICATE", "UNSUPPORTED_CERTIFICATE", "CERTIFICATE_REVOKED",
    "CERTIFICATE_EXPIRED", "CERTIFICATE_UNKNOWN", "CERTIFICATE_REQUIRED", "ACCESS_DENIED",
)  # fmt: skip

# Seconds between two checks of the certificate of an open connection.
CERTIFICATE_INTERVAL = 60.0


def security_of(endpoint: Endpoint, security: Given | None) -> Security | Given:
    """Return the security of a `tls://` endpoint, from its URL or the argument."""
    if not endpoint.options:
        if security is None:
            raise ValueError(
                f"{endpoint} needs security: Security(...), or ?cert=...&key=... and ca or pin,"
                " which are options of commands, too"
            )
        return security
    if security is not None:
        raise ValueError(f"{endpoint}: security is given as such and in the URL")
    options: dict[str, Any] = dict(endpoint.options)
    if "cert" not in options:
        raise ValueError(f"{endpoint} lacks cert, the file with one's own certificate")
    if ("ca" in options) == ("pin" in options):
        raise ValueError(f"{endpoint} needs either ca, the authorities, or pin, certificates")
    if "pin" in options:
        options["pin"] = options["pin"].split(",")
    if (name := options.pop("password_env", None)) is not None:
        if name not in os.environ:
            raise ValueError(f"password_env: no environment variable {name!r}")
        options["password"] = os.environ[name]
    arguments = {"cert": "certificate", "ca": "trust"}
    return Security(**{arguments.get(name, name): value for name, value in options.items()})


class TlsPort(TcpPort):
    """A TLS connection, open once each side has accepted the other's certificate."""

    _acceptance: Acceptance  # this and the next two belong to the tunnel
    _check_at: float
    _owner: int  # the process

    @classmethod
    def of(cls, endpoint: Endpoint, settings: ConnectionOptions) -> Self:
        security = security_of(endpoint, settings["security"])
        keepalive, source = settings["keepalive"], settings["source"]
        return cls(endpoint.host, endpoint.port, keepalive, source, security=security)

    def __init__(
        self,
        host: str,
        port: int,
        keepalive: float | None,
        source: str | None = None,
        *,
        security: ClientSecurity,
    ) -> None:
        super().__init__(host, port, keepalive, source)
        self._security = security
        self._session: ssl.SSLSession | None = None  # which the next connection resumes
        self._begin(None)

    @property
    def certificate(self) -> bytes:
        return self._security.own

    def _begin(self, tunnel: Tunnel | None) -> None:
        self._tunnel = tunnel
        self._received: list[bytes] = []  # decrypted
        self._plain = bytearray()  # not encrypted yet
        self._failure: ModbusConnectionError | None = None  # raised after the received bytes
        self._unasked = 0  # bytes behind the last answer: tickets and changes of keys are rare
        self._flights = 0  # how often this side has sent during the handshake
        self._has_answered = False

    def _preparing(self, connection: socket.socket, deadline: float) -> Steps[None]:
        yield from super()._preparing(connection, deadline)
        session, self._session = self._session, None  # after a failure no session is resumed
        self._acceptance = self._security.acceptance()
        tunnel = self._security.to_server(self.host, session)
        self._begin(None)
        try:
            yield from self._shaking_hands(connection, tunnel, deadline)
        except ssl.SSLCertVerificationError as error:
            raise self._distrusting(in_words(error), tunnel.certificate) from error
        except ssl.SSLError as error:
            raise self._because(error) from error
        except OSError as error:
            raise self._unfinished(of_system(error)) from error
        if (reason := self._security.refusal(tunnel)) is not None:
            raise self._distrusting(reason, tunnel.certificate)
        self._acceptance.begin(tunnel)
        self._check_at = time.monotonic() + CERTIFICATE_INTERVAL
        self._tunnel, self._owner = tunnel, os.getpid()

    def _shaking_hands(
        self, connection: socket.socket, tunnel: Tunnel, deadline: float
    ) -> Steps[None]:
        while True:
            try:
                is_done = tunnel.handshake()
            except ssl.SSLError:
                with contextlib.suppress(OSError):  # send the alert, if the peer still receives
                    connection.send(tunnel.outgoing())
                raise
            data = tunnel.outgoing()
            self._flights += bool(data)
            while data:
                try:
                    data = data[connection.send(data) :]
                except BlockingIOError:
                    yield from _ready(connection, WRITE, deadline)
            if is_done:
                return
            yield from _ready(connection, READ, deadline)
            if not (chunk := connection.recv(RECEIVED_BYTES)):
                raise ConnectionResetError(errno.ECONNRESET, "closed by the other side")
            tunnel.feed(chunk)

    def _distrusting(self, reason: str, certificate: bytes) -> ModbusConnectionError:
        details = f": {describe(certificate)}" if certificate else ""
        text = f"cannot trust {self}: {reason.rstrip('.')}{details}"
        return ModbusConnectionError(text, errno=KEY_REJECTED)

    def _unfinished(self, error: OSError) -> ModbusConnectionError:
        is_ended = error.errno in (errno.ECONNRESET, errno.ETIMEDOUT)
        hint = "; does it speak TLS, or is it tcp://?" if is_ended else ""
        reason = f"no TLS handshake with {self}: {error.strerror or error}{hint}"
        failure = ModbusConnectionError(reason, errno=error.errno)
        # In TLS 1.2 the second flight has our certificate.
        is_hanging = self._flights > 1 and error.errno == errno.ECONNRESET
        return self._suspecting(failure) if is_hanging else failure

    def _because(self, error: ssl.SSLError) -> ModbusConnectionError:
        words = in_words(error, guess=True)
        if (error.reason or "").endswith(OF_OUR_CERTIFICATE):
            own = f": {describe(self._security.own)}" if self._security.own else ""
            text = f"{self} refused our certificate ({words}){own}"
            failure = ModbusConnectionError(text, errno=KEY_REJECTED)
        else:
            failure = ModbusConnectionError(f"no TLS with {self}: {words}", errno=errno.EPROTO)
        failure.__cause__ = error
        return failure

    def _suspecting(self, error: ModbusConnectionError) -> ModbusConnectionError:
        """Add a hint to an error: some servers refuse a certificate silently, and late."""
        if not self._has_answered:
            error.args = (f"{error.args[0]}; it may have refused our certificate",)
        return error

    def _watch(self, descriptor: int) -> None:
        super()._watch(descriptor)
        self._has_bytes, self.has_input = self.has_input, self._has_plaintext

    def _has_plaintext(self) -> bool:
        # A connection that ends here, before a request, is made again, as if the server had closed
        # it: the server may have a new certificate by now.
        self._check_certificate(time.monotonic())
        # Tickets contain no data; an answer, or the end, may follow them.
        while not self._received and self._failure is None and self._has_bytes():
            self._read()
        return bool(self._received) or self._failure is not None

    def receive(self) -> list[bytes]:
        if not self._received and self._failure is None:
            self._read()
        chunks, self._received = self._received, []
        if self._failure is not None:
            if not chunks:
                raise self._failure
            try:  # make the descriptor readable, so that a waiting program reads here once more
                self._socket.shutdown(socket.SHUT_RD)
            except OSError as error:
                of_system(error)
        return chunks

    def _read(self) -> None:
        """Receive, and set what was decrypted and why the connection has ended."""
        tunnel = self._tunnel
        assert tunnel is not None
        try:
            for data in super().receive():
                self._unasked += len(data)
                tunnel.feed(data)
            while piece := tunnel.receive(RECEIVED_BYTES):
                self._received.append(piece)
                self._unasked = 0
        except ModbusConnectionError as error:
            self._failure = self._suspecting(error)
        except ssl.SSLError as error:
            self._end(tunnel, error)
        else:
            if piece is not None:
                reset = ModbusConnectionError("closed by the other side", errno=errno.ECONNRESET)
                self._failure = self._suspecting(reset)
            # Delayed requests, and records of OpenSSL itself: a change of keys, an alert.
            self._send(tunnel, b"")
        self._has_answered = self._has_answered or bool(self._received)
        if self._unasked > MAX_UNASKED_BYTES and self._failure is None:
            self._failure = ModbusConnectionError("flooded with bytes that are not a response")

    def send(self, adus: list[bytes], now: float) -> None:
        # A connection that is never idle is not asked for input.
        self._check_certificate(now - CERTIFICATE_INTERVAL)
        if self._failure is None:
            assert self._tunnel is not None
            self._send(self._tunnel, b"".join(adus))
            if self._failure is not None and self._tunnel is not None:
                # In TLS 1.3 a server refuses a certificate when the handshake is over for us,
                # and what it said is still there.
                failure, self._failure = self._failure, None
                self.has_input()
                self._failure = self._failure or failure
        if self._failure is not None:
            raise self._failure

    def _send(self, tunnel: Tunnel, data: bytes) -> None:
        """Encrypt and send, behind what waits for that; set why the connection has ended."""
        data = bytes(self._plain) + data
        self._plain.clear()
        try:
            if data:
                tunnel.send(data)
        except ssl.SSLWantReadError:
            # In the midst of a ticket that came in several records nothing can be encrypted.
            self._plain += data
        except ssl.SSLError as error:
            self._end(tunnel, error)
        try:
            if records := tunnel.outgoing():
                super().send([records], 0.0)
        except ModbusConnectionError as error:
            self._failure = self._failure or self._suspecting(error)

    def _end(self, tunnel: Tunnel, error: ssl.SSLError) -> None:
        """End a connection that one side refused, so that it is never resumed (R-11)."""
        self._failure = self._because(error)
        self._tunnel = None
        with contextlib.suppress(ModbusConnectionError):
            super().send([tunnel.outgoing()], 0.0)

    def _check_certificate(self, now: float) -> None:
        if self._tunnel is None or now <= self._check_at:
            return
        self._check_at = time.monotonic() + CERTIFICATE_INTERVAL
        self._security.warn_of_end()
        if (reason := self._acceptance.refusal()) is not None:
            self._failure = self._distrusting(reason, self._tunnel.certificate)

    def close(self) -> None:
        # A close_notify would end the connection of the parent process.
        if self._tunnel is not None and self._owner == os.getpid():
            self._session = self._tunnel.session
            self._tunnel.end()
            with contextlib.suppress(ModbusConnectionError):
                super().send([self._tunnel.outgoing()], 0.0)
        super().close()

    def _release(self) -> None:
        self._begin(None)
        super()._release()


def _ready(connection: socket.socket, events: int, deadline: float) -> Steps[None]:
    # A flooding peer always has bytes ready.
    in_time = time.monotonic() < deadline and (yield Ready(connection.fileno(), events, deadline))
    if not in_time:
        raise timed_out()
