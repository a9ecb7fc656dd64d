"""
The own certificate and key, and the certificates that are trusted.
"""

from __future__ import annotations

import contextlib
import math
import os
import ssl
import time
from collections.abc import Iterable
from typing import Any

from ..protocol.close_names import named_arguments
from ..protocol.logs import HarmlessLogger
from .acceptance import Acceptance
from .files import File, place_of
from .loaded import Loaded, SecurityFiles
from .renewed import keep_renewed
from .tunnel import Tunnel, expiry, name_of

__all__ = ["Security"]

logger: HarmlessLogger = HarmlessLogger(__name__)

DAY = 86_400

# A certificate that ends within this many seconds is warned about.
WARNED_BEFORE = 30 * DAY

# The same for a revocation list; most are renewed every day or week.
WARNED_BEFORE_OF_CRL = 2 * DAY

# The length that OpenSSL accepts.
MAX_PASSWORD = 1024


@named_arguments
class Security:
    """
    The own certificate and the trusted ones for `tls://`, for clients and servers.

    Modbus/TCP Security v36: both sides present a certificate and check the other's, with TLS 1.2 or
    newer. With `trust`, the peer's certificate must be signed by one of these authorities and be
    valid now, and that of a server must contain its name. With `pin`, it must be one of exactly
    these certificates, whatever its signature and age: most devices in the field have self-signed
    certificates.

    Args:
        certificate: a PEM file with the own certificate, followed by the others of its chain
            (R-46).
        key: a PEM file with the private key; None if the key is in the same file.
        trust: a PEM file with the certificates of the authorities.
        pin: one or several certificates, each as a PEM file, or as the 64 hexadecimal digits
            of its SHA-256, with or without colons. A server needs files, because Python's ssl
            module can only accept certificates that it has.
        server_name: the name or address that a server's certificate must contain (with
            `trust`); None for the host that a client connects to. Servers ignore it.
        password: the password of an encrypted key.
        crl: a PEM file with the revocation lists of all authorities in `trust`, and of those
            below them. This needs the package cryptography.
        cert, ca: `certificate` and `trust` by their names in URLs.

    Raises:
        TypeError, ValueError: a file cannot be read or has wrong content, the key does not
            belong to the certificate or has another password, both or none of `trust` and `pin`
            are given, or `crl` is given with `pin`.
        ImportError: `crl` is given, and cryptography is not installed.
    """

    def __init__(
        self,
        certificate: File | None = None,
        key: File | None = None,
        *,
        trust: File | None = None,
        pin: File | Iterable[File] | None = None,
        server_name: str | None = None,
        password: str | None = None,
        crl: File | None = None,
        cert: File | None = None,
        ca: File | None = None,
    ) -> None:
        own = _either("certificate", certificate, "cert", cert)
        if own is None:
            raise TypeError("security needs certificate, a PEM file with one's own certificate")
        trust = _either("trust", trust, "ca", ca)
        if (trust is None) == (pin is None):
            raise ValueError("security needs either trust, the authorities, or pin, certificates")
        if crl is not None and trust is None:
            raise ValueError("crl needs trust: a pinned certificate is revoked by removing its pin")
        for name, text in (("server_name", server_name), ("password", password)):
            if text is not None and not isinstance(text, str):
                raise TypeError(f"{name} must be a string, not {type(text).__name__}")
        if password is not None and len(password.encode()) > MAX_PASSWORD:
            raise ValueError(f"password must have {MAX_PASSWORD} bytes of UTF-8 at most")
        pins = None if pin is None else _listed(pin)
        self._files = SecurityFiles(own, key, password, trust, pins, crl)
        self._server_name = server_name
        self.loaded: Loaded = Loaded(self._files, for_server=False)
        self._warned_at = -math.inf
        if server_name is not None:
            self._check_server_name(server_name)
        keep_renewed(self)

    def __repr__(self) -> str:
        trust = self._files.trust
        whom = f"trust={os.fspath(trust)!r}" if trust is not None else "pin=..."
        return f"Security({os.fspath(self._files.certificate)!r}, {whom})"

    def reload(self) -> None:
        """
        Read all files again, for connections made from now on.

        Open connections whose certificate is no longer trusted, or was revoked, are closed within a
        minute; those of servers within `Limits.certificate_interval`. If an authority was removed,
        all of them are closed, and may connect again.

        Raises:
            TypeError, ValueError: a file is wrong; nothing has changed.
        """
        self.loaded = Loaded(self._files, for_server=self.loaded.server is not None)
        self._warned_at = -math.inf

    @property
    def own(self) -> bytes:
        """The own certificate in DER."""
        return self.loaded.own

    @property
    def ends(self) -> float | None:
        """
        The time at which the own certificate expires, in seconds since 1970.

        None without the package cryptography.
        """
        return self.loaded.ends

    # --- tunnels ------------------------------------------------------------------------------

    def to_server(self, host: str, session: ssl.SSLSession | None = None) -> Tunnel:
        """
        Return the client's end of a tunnel.

        Args:
            host: the host of the server.
            session: the session of an earlier tunnel to it, to resume.
        """
        name = name_of(host if self._server_name is None else self._server_name)
        context = self.loaded.client
        if session is not None:
            # OpenSSL resumes no session of other settings, such as those before `reload`.
            with contextlib.suppress(ValueError):
                return Tunnel(context, server_name=name, session=session)
        return Tunnel(context, server_name=name)

    def check_server(self) -> None:
        """
        Check that `to_client` can be called.

        Raises:
            ValueError: a pin is given without its certificate, or a file is wrong now.
        """
        if self.loaded.server is None:
            self.loaded = Loaded(self._files, for_server=True)

    def to_client(self) -> Tunnel:
        """Return the server's end of a tunnel; see `check_server`."""
        context = self.loaded.server
        assert context is not None
        return Tunnel(context)

    def refusal(self, tunnel: Tunnel) -> str | None:
        """Return why a certificate is refused after a good handshake; None if it is not."""
        if not self.loaded.has_pins:
            return expiry(tunnel)
        # A pinned certificate is trusted even if it has expired.
        return None if self.accepts(tunnel.certificate) else "it is none of the pins"

    def accepts(self, certificate: bytes) -> bool:
        """Return True if a certificate is one of the pins, or if there are no pins."""
        return self.loaded.accepts(certificate)

    def acceptance(self) -> Acceptance:
        """Return what checks later whether the certificate of a connection is still valid."""
        return Acceptance(lambda: self.loaded)

    def warn_of_end(self) -> None:
        """Log a warning, once a day, if the own certificate or a revocation list expires soon."""
        now = time.time()
        if now < self._warned_at + DAY:
            return
        revoked = self.loaded.revoked
        endings = [
            (place_of("certificate", self._files.certificate), self.ends, WARNED_BEFORE),
            (
                place_of("crl", self._files.crl or ""),
                revoked.ends if revoked else None,
                WARNED_BEFORE_OF_CRL,
            ),
        ]
        for what, end, before in endings:
            if end is not None and end - now < before:
                logger.warning("%s %s", what, _ending(end - now))
        self._warned_at = now

    def _check_server_name(self, name: str) -> None:
        try:
            self.to_server(name)
        except (TypeError, ValueError, ssl.SSLError):
            text = f"server_name must be a name or an address, not {name!r}"
            raise ValueError(text) from None


def _ending(left: float) -> str:
    """Return what a warning says; `left`: seconds until the end."""
    if left < 0:
        return "has expired"
    return f"expires in {left / DAY:.0f} days" if left > 2 * DAY else "expires within two days"


def _either(name: str, value: File | None, other_name: str, other: File | None) -> File | None:
    """Return the value of an argument that has two names."""
    if value is not None and other is not None:
        raise TypeError(f"{name} and {other_name} are the same argument, and both are given")
    return other if value is None else value


def _listed(pin: Any) -> tuple[File, ...]:
    """Return the pins, one or several, as they can be read again."""
    if isinstance(pin, Iterable) and not isinstance(pin, str):
        return tuple(pin)
    return (pin,)
