"""One TLS connection without a socket: received bytes in, bytes to send out."""

from __future__ import annotations

import contextlib
import ssl
import time
from collections.abc import Callable
from typing import Any

# The reason for which a connection ends, in the words of OpenSSL.
EXPIRED = "certificate has expired"

# SSL_OP_NO_RX_CERTIFICATE_COMPRESSION of OpenSSL 3.2, which Python's ssl does not name.
NO_COMPRESSED_CERTIFICATE = 1 << 33


class _ServerEnd(ssl.SSLObject):
    """A server's end of a connection; `presented` is the certificate that the client has sent."""

    presented: bytes = b""


def keep_presented(context: ssl.SSLContext) -> None:
    """Let a server's connections keep the certificate that the client presents, even if refused."""
    # OpenSSL forgets what a server refuses. Python's hook for messages, which its own tests use,
    # gets the certificate before, for 1.3 us for each request later on.
    hook = getattr(ssl.SSLContext.__base__, "_msg_callback", None)
    if hook is None:
        return
    context.sslobject_class = _ServerEnd
    hook.__set__(context, _note_message)  # that of ssl.SSLContext makes enums for each record
    # The hook would get a compressed certificate (RFC 8879) as it is, and Python has not all of the
    # algorithms. A client compresses its certificate only for a server that says it can read that.
    if ssl.OPENSSL_VERSION_INFO >= (3, 2):
        with contextlib.suppress(OverflowError):  # an older Python has 32 bits of options
            context.options |= NO_COMPRESSED_CERTIFICATE


def _note_message(
    end: Any, direction: str, version: int, kind: int, message: int, data: Any
) -> None:
    # A Certificate in a record of the handshake (RFC 8446, 4 and 5.1).
    if message == 11 and kind == 22 and direction == "read":
        end.presented = _first_certificate(version, bytes(data))


def _first_certificate(version: int, message: bytes) -> bytes:
    """Return the first certificate of a handshake message (RFC 5246, 7.4.2; RFC 8446, 4.4.2)."""
    at = 4  # behind the type and the length
    if version >= ssl.TLSVersion.TLSv1_3:
        at += 1 + int.from_bytes(message[at : at + 1], "big")  # the context of the request
    at += 3  # the length of the list
    size = int.from_bytes(message[at : at + 3], "big")
    return message[at + 3 : at + 3 + size]


class Tunnel:
    """
    One end of a TLS connection.

    `feed` takes bytes from the wire, `outgoing` returns bytes that must go there, after every
    call, and `send` takes bytes to encrypt. With a `server_name`, which the server must have, it
    is the client's end, which may resume an earlier `session`.
    """

    __slots__ = ("_incoming", "_tls", "feed", "outgoing", "send")

    def __init__(
        self,
        context: ssl.SSLContext,
        *,
        server_name: str | None = None,
        session: ssl.SSLSession | None = None,
    ) -> None:
        self._incoming = ssl.MemoryBIO()
        records = ssl.MemoryBIO()
        self._tls = context.wrap_bio(
            self._incoming,
            records,
            server_side=server_name is None,
            server_hostname=server_name,
            session=session,
        )
        # Bound once: each request passes all three.
        self.feed: Callable[[bytes], object] = self._incoming.write
        self.outgoing: Callable[[], bytes] = records.read
        self.send: Callable[[bytes], object] = self._tls.write

    def handshake(self) -> bool:
        """Continue the handshake; return True at its end, or raise SSLError with `outgoing`."""
        try:
            self._tls.do_handshake()
        except ssl.SSLWantReadError:
            return False
        if isinstance(self._tls, _ServerEnd):
            self._tls.presented = b""  # OpenSSL has it, too
        return True

    def receive(self, most: int) -> bytes | None:
        """Return received bytes, decrypted; None if there are none, b"" at the end."""
        try:
            return self._tls.read(most)
        except ssl.SSLWantReadError:
            return None

    def end(self) -> None:
        with contextlib.suppress(ssl.SSLError):  # it was refused before
            self._tls.unwrap()

    @property
    def has_more(self) -> bool:
        """True if bytes were received that `receive` has not returned."""
        return bool(self._incoming.pending or self._tls.pending())

    @property
    def certificate(self) -> bytes:
        """The other side's certificate in DER; also if refused, or if the session is resumed."""
        try:
            return self._tls.getpeercert(True) or b""
        except ValueError:  # the handshake will never be over
            der: bytes = getattr(self._tls, "presented", b"")
            # OpenSSL 3 keeps what a client refuses.
            return der or next(iter(self._certificates("get_unverified_chain")), b"")

    @property
    def chain(self) -> list[bytes]:
        """The other side's certificate and those of its authorities in DER, as far as checked."""
        return self._certificates("get_verified_chain") or [self.certificate]

    def _certificates(self, name: str) -> list[bytes]:
        # Python 3.13 has this in its API; older ones only have it in the object inside.
        inner = self._tls._sslobj  # type: ignore[attr-defined]  # pyright: ignore
        chain = getattr(inner, name)() if inner is not None else None
        return [ssl.PEM_cert_to_DER_cert(certificate.public_bytes()) for certificate in chain or ()]

    @property
    def expires(self) -> str | None:
        """The expiry of the other side's certificate, in OpenSSL's format; None if unchecked."""
        fields = self._tls.getpeercert() or {}
        return fields.get("notAfter")  # type: ignore[return-value]

    @property
    def is_resumed(self) -> bool:
        return bool(self._tls.session_reused)

    @property
    def session(self) -> ssl.SSLSession | None:
        return self._tls.session


def expiry(tunnel: Tunnel) -> str | None:
    """Return an error text if the peer's certificate has expired since a resumed session began."""
    # OpenSSL checks the dates when a session begins, not when it is resumed.
    until = tunnel.expires if tunnel.is_resumed else None
    if until is None or ssl.cert_time_to_seconds(until) >= time.time():
        return None
    return EXPIRED


def name_of(host: str) -> str:
    """Return the name that a host's certificate must have."""
    return host.partition("%")[0]  # the zone of an IPv6 address is not part of the name


class Records:
    """Finds the ends of the records of a stream, which OpenSSL does not report."""

    __slots__ = ("_header", "_left", "is_midway")

    def __init__(self) -> None:
        self._header = b""  # the beginning of one
        self._left = 0  # bytes of the record
        self.is_midway: bool = False  # a record has begun and not ended

    def follow(self, data: bytes) -> bool:
        """Take received bytes; return True if they are exactly one record, as they mostly are."""
        start, size = self._left, len(data)
        if not self.is_midway and size >= 5 and size == 5 + (data[3] << 8 | data[4]):
            return True
        if self._header:
            data = self._header + data
            size = len(data)
        # Type, version and length; the length excludes these bytes (RFC 8446, 5.1).
        while size - start >= 5:
            start += 5 + (data[start + 3] << 8 | data[start + 4])
        self._left = max(0, start - size)
        self._header = data[start:]
        self.is_midway = start != size
        return False
