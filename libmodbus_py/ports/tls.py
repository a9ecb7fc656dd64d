"""
TLS connections: Modbus Security, at the client's end.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import ssl
from typing import Any

from ..protocol.errors import ModbusConnectionError
from ..security.describing import describe
from ..security.security import Security
from ..security.tunnel import READ_SIZE, Tunnel
from .endpoint import Endpoint
from .sockets import TcpPort
from .waiting import READ, WRITE, Ready, Steps

__all__ = ["TlsPort", "security_of"]

# What the other side's alerts say of our certificate, as OpenSSL's reasons end.
OF_OUR_CERTIFICATE = (
    "UNKNOWN_CA",
    "BAD_CERTIFICATE",
    "UNSUPPORTED_CERTIFICATE",
    "CERTIFICATE_REVOKED",
    "CERTIFICATE_EXPIRED",
    "CERTIFICATE_UNKNOWN",
    "CERTIFICATE_REQUIRED",
    "ACCESS_DENIED",
)

# What it is called in URLs -> what in `Security`.
NAMES = {"cert": "certificate", "key": "key", "ca": "trust", "server_name": "server_name"}


def security_of(endpoint: Endpoint, given: Security | None) -> Security:
    """
    Find who we are at a `tls://` endpoint: in its URL or as given.

    Raises:
        TypeError, ValueError: in neither or in both; or as of `Security`.
    """
    options = dict(endpoint.options)
    if not options:
        if given is None:
            raise ValueError(
                f"{endpoint} needs security: Security(...), or ?cert=...&key=... and ca or pin"
            )
        return given
    if given is not None:
        raise ValueError(f"{endpoint}: security is given as such and in the URL")
    if "cert" not in options:
        raise ValueError(f"{endpoint} lacks cert, the file with one's own certificate")
    named: dict[str, Any] = {NAMES[name]: options[name] for name in NAMES if name in options}
    if "pin" in options:
        named["pin"] = options["pin"].split(",")
    if "password_env" in options:
        named["password"] = _from_environment(options["password_env"])
    return Security(**named)


def _from_environment(name: str) -> str:
    try:
        return os.environ[name]
    except KeyError:
        raise ValueError(f"password_env: no environment variable {name!r}") from None


class TlsPort(TcpPort):
    """
    A TLS connection; it is open when each side has seen the other's certificate.

    The next one resumes its session, if the server is so minded (R-42).

    Args:
        host, port, keepalive: as for `TcpPort`.
        security: who we are, and whom we trust.
    """

    def __init__(self, host: str, port: int, keepalive: float | None, security: Security) -> None:
        super().__init__(host, port, keepalive)
        self._security = security
        self._tunnel: Tunnel | None = None
        self._session: ssl.SSLSession | None = None
        # Read in search of input, which only a decrypted record is.
        self._received: list[bytes] = []
        self._failure: ModbusConnectionError | None = None

    # --- opening ------------------------------------------------------------------------------

    def _preparing(self, made: socket.socket, deadline: float) -> Steps[None]:
        yield from super()._preparing(made, deadline)
        self._tunnel, self._received, self._failure = None, [], None
        session, self._session = self._session, None  # after a failure none is resumed
        tunnel = self._security.to_server(self.host, session)
        try:
            yield from self._shaking_hands(made, tunnel, deadline)
        except ssl.SSLCertVerificationError as error:
            made.close()
            certificate = yield from self._looking(deadline)
            raise self._distrusting(error.verify_message, certificate) from error
        except ssl.SSLError as error:
            raise self._because(error) from error
        except OSError as error:
            raise self._unfinished(error) from error
        if not self._security.accepts(tunnel.certificate):
            raise self._distrusting("it is none of the pins", tunnel.certificate)
        self._tunnel = tunnel

    def _shaking_hands(self, made: socket.socket, tunnel: Tunnel, deadline: float) -> Steps[None]:
        while True:
            try:
                is_done = tunnel.handshake()
            finally:  # an alert, too
                yield from _sending(made, tunnel.outgoing(), deadline)
            if is_done:
                return
            yield from _ready(made, READ, deadline)
            data = made.recv(READ_SIZE)
            if not data:
                raise ConnectionResetError(errno.ECONNRESET, "closed by the other side")
            tunnel.feed(data)

    def _looking(self, deadline: float) -> Steps[bytes]:
        """Get the certificate that was refused, and that ssl keeps to itself."""
        tunnel = self._security.to_anybody(self.host)
        try:
            made = yield from self._connected(deadline)
        except ModbusConnectionError:
            return b""
        with made:
            try:
                yield from self._shaking_hands(made, tunnel, deadline)
            except OSError:
                return b""
        return tunnel.certificate

    # --- what is wrong ------------------------------------------------------------------------

    def _distrusting(self, reason: str, certificate: bytes) -> ModbusConnectionError:
        shown = f": {describe(certificate)}" if certificate else ""
        return ModbusConnectionError(
            f"cannot trust {self}: {reason}{shown}", errno=errno.EKEYREJECTED
        )

    def _unfinished(self, error: OSError) -> ModbusConnectionError:
        reason = f"no TLS handshake with {self}: {error.strerror or error}"
        return ModbusConnectionError(reason, errno=error.errno)

    def _because(self, error: ssl.SSLError) -> ModbusConnectionError:
        reason = error.reason or str(error)
        words = reason.lower().replace("_", " ")
        if reason.endswith(OF_OUR_CERTIFICATE):
            own = describe(self._security.own)
            text = f"{self} refused our certificate ({words}): {own}"
            made = ModbusConnectionError(text, errno=errno.EKEYREJECTED)
        else:
            made = ModbusConnectionError(f"no TLS with {self}: {words}", errno=errno.EPROTO)
        made.__cause__ = error
        return made

    # --- open -----------------------------------------------------------------------------------

    def has_input(self) -> bool:
        if not self._received and self._failure is None and super().has_input():
            try:
                self._received = self._read()
            except ModbusConnectionError as error:
                self._failure = error
        return bool(self._received) or self._failure is not None

    def receive(self) -> list[bytes]:
        if self._received:
            received, self._received = self._received, []
            return received
        if self._failure is not None:
            raise self._failure
        return self._read()

    def _read(self) -> list[bytes]:
        tunnel = self._tunnel
        assert tunnel is not None
        for data in super().receive():
            tunnel.feed(data)
        found: list[bytes] = []
        try:
            while piece := tunnel.receive():
                found.append(piece)
        except ssl.SSLError as error:
            self._failure = self._because(error)
        else:
            if piece is not None:
                reason = "closed by the other side"
                self._failure = ModbusConnectionError(reason, errno=errno.ECONNRESET)
        if answer := tunnel.outgoing():  # a change of keys, or an alert
            super().send([answer], 0.0)
        if self._failure is not None and not found:
            raise self._failure
        return found

    def send(self, adus: list[bytes], now: float) -> None:
        tunnel = self._tunnel
        assert tunnel is not None
        tunnel.send(adus[0] if len(adus) == 1 else b"".join(adus))
        try:
            super().send([tunnel.outgoing()], now)
        except ModbusConnectionError:
            # In TLS 1.3 a server refuses a certificate when the handshake is over for us,
            # and what it said is still there.
            self.has_input()
            raise self._failure or ModbusConnectionError("closed by the other side") from None

    def close(self) -> None:
        tunnel = self._tunnel
        if tunnel is not None and self.descriptor >= 0:
            if self._failure is None:
                self._session = tunnel.session
            tunnel.end()
            with contextlib.suppress(ModbusConnectionError):
                super().send([tunnel.outgoing()], 0.0)
        super().close()


def _sending(made: socket.socket, data: bytes, deadline: float) -> Steps[None]:
    while data:
        try:
            data = data[made.send(data) :]
        except BlockingIOError:
            yield from _ready(made, WRITE, deadline)


def _ready(made: socket.socket, events: int, deadline: float) -> Steps[None]:
    if not (yield Ready(made.fileno(), events, deadline)):
        raise TimeoutError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))
