"""The server's side of TLS for peers that tests write, without a socket: bytes in, bytes out."""

import contextlib
import ssl
from functools import cache
from typing import Any

from libmodbus_py.tools.certificates import Identity

from .certificates import Pki, client, lasting_pki, server

VERSIONS = {"1.2": ssl.TLSVersion.TLSv1_2, "1.3": ssl.TLSVersion.TLSv1_3}


def context_of(
    pki: Pki, identity: Identity, version: str | None = None, **options: Any
) -> ssl.SSLContext:
    """Make a server's context; options are attributes of it."""
    files = pki.files(identity)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(files.cert, files.key)
    context.load_verify_locations(pki.ca)
    context.verify_mode = ssl.CERT_REQUIRED
    if version is not None:
        context.minimum_version = context.maximum_version = VERSIONS[version]
    for name, value in options.items():
        setattr(context, name, value)
    return context


@cache
def _context() -> ssl.SSLContext:
    return context_of(lasting_pki(), server())


@cache
def _query() -> str:
    return lasting_pki().url("", client())


def with_certificates(url: str) -> str:
    """Return the URL of a peer with all that a client needs to connect there."""
    return f"{url}{_query()}&server_name=localhost" if url.startswith("tls:") else url


class Sealing:
    """One connection of a server. `is_ended`: the client said goodbye, or is refused."""

    def __init__(self) -> None:
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = _context().wrap_bio(self._incoming, self._outgoing, server_side=True)
        self._is_open = False
        self.is_ended: bool = False

    def take(self, data: bytes) -> bytes:
        """Receive records; return the decrypted bytes."""
        self._incoming.write(data)
        plain = b""
        try:
            if not self._is_open:
                self._tls.do_handshake()
                self._is_open = True
            while piece := self._tls.read(16_384):
                plain += piece
            self.is_ended = True
        except ssl.SSLWantReadError:
            pass
        except ssl.SSLError:
            self.is_ended = True
        return plain

    def seal(self, data: bytes) -> None:
        """Encrypt the bytes in `outgoing`."""
        self._tls.write(data)

    def end(self) -> None:
        """Say goodbye."""
        with contextlib.suppress(ssl.SSLError):
            self._tls.unwrap()

    def outgoing(self) -> bytes:
        """Return the records to send."""
        return self._outgoing.read()
