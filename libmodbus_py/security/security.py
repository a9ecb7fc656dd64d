"""
The own certificate and key, and the certificates that are trusted; certificates, keys and passwords
that are read from files again.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import ssl
import stat
import time
import weakref
from collections.abc import Callable, Iterable
from typing import Any, Generic, Protocol, TypeVar

from ..protocol.logs import HarmlessLogger
from ..protocol.mistakes import Problem, named_arguments
from ..system import open_file
from .files import Acceptance, File, LoadedFiles, PemFile, SecurityFiles
from .tunnel import Tunnel, expiry, name_of

logger: HarmlessLogger = HarmlessLogger(__name__)

DAY_S = 86_400


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
    ) -> None:
        if certificate is None:
            raise TypeError("security needs certificate, a PEM file with one's own certificate")
        if (trust is None) == (pin is None):
            raise ValueError("security needs either trust, the authorities, or pin, certificates")
        if crl is not None and trust is None:
            raise ValueError("crl needs trust: a pinned certificate is revoked by removing its pin")
        for name, text in (("server_name", server_name), ("password", password)):
            if text is not None and not isinstance(text, str):
                raise TypeError(f"{name} must be a string, not {type(text).__name__}")
        pins: Any = () if pin is None else pin
        if isinstance(pins, str) or not isinstance(pins, Iterable):
            pins = (pins,)
        self._files = SecurityFiles(
            PemFile("certificate", certificate),
            PemFile("key", certificate if key is None else key),
            password,
            None if trust is None else PemFile("trust", trust),
            tuple(pins),
            None if crl is None else PemFile("crl", crl),
        )
        self._server_name = server_name
        self.loaded: LoadedFiles = LoadedFiles(self._files)
        self._warned_at = -math.inf
        if server_name is not None:
            try:
                self.to_server(server_name)
            except (TypeError, ValueError, ssl.SSLError):
                text = f"server_name must be a name or an address, not {server_name!r}"
                raise ValueError(text) from None
        keep_renewed(self)

    def __repr__(self) -> str:
        trust = self._files.trust
        whom = "pin=..." if trust is None else f"trust={os.fspath(trust.path)!r}"
        return f"Security({os.fspath(self._files.certificate.path)!r}, {whom})"

    def reload(self) -> None:
        """
        Read all files again, for connections made from now on.

        Open connections whose certificate is no longer trusted, or was revoked, are closed within a
        minute; those of servers within `Limits.certificate_interval`. If an authority was removed,
        all of them are closed, and may connect again.

        Raises:
            TypeError, ValueError: a file is wrong; nothing has changed.
        """
        self.loaded = LoadedFiles(self._files)
        self._warned_at = -math.inf

    @property
    def own(self) -> bytes:
        """The own certificate in DER."""
        return self.loaded.own

    @property
    def ends(self) -> float | None:
        """When the own certificate expires, in seconds since 1970; None without cryptography."""
        return self.loaded.ends

    def to_server(self, host: str, session: ssl.SSLSession | None = None) -> Tunnel:
        """Return the client's end of a tunnel; `session` is that of an earlier one, to resume."""
        name = name_of(host if self._server_name is None else self._server_name)
        context = self.loaded.client
        if session is not None:
            # OpenSSL resumes no session of other settings, such as those before `reload`.
            with contextlib.suppress(ValueError):
                return Tunnel(context, server_name=name, session=session)
        return Tunnel(context, server_name=name)

    def to_client(self) -> Tunnel:
        """Return the server's end of a tunnel, after `check_server`."""
        return Tunnel(self.loaded.server)

    def check_server(self) -> None:
        """
        Check that a server can use the files.

        Raises:
            ValueError: a pin is given without its certificate.
        """
        _ = self.loaded.server

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
        if now < self._warned_at + DAY_S:
            return
        lists = self.loaded.revoked
        # Most revocation lists are renewed every day or week.
        for file, end, before in (
            (self._files.certificate, self.ends, 30 * DAY_S),
            (self._files.crl, lists.ends if lists else None, 2 * DAY_S),
        ):
            if end is not None and end - now < before:
                days = (end - now) / DAY_S
                soon = f"expires in {days:.0f} days" if days > 2 else "expires within two days"
                logger.warning("%s %s", file, soon if days >= 0 else "has expired")
        self._warned_at = now


class GivenContext:
    """
    A client's SSLContext used as it is, for programs that must use an existing one.

    The checks of a server are those of the context, which may be none at all. Prefer `Security`,
    which makes the checks that Modbus Security requires.

    Args:
        context: a context for clients; it may serve any number of connections.

    Attributes:
        own: empty, because a context does not tell which certificate it shows.

    Raises:
        TypeError: the argument is not an SSLContext.
        ValueError: the context is for servers.
    """

    own: bytes = b""

    def __init__(self, context: ssl.SSLContext) -> None:
        if not isinstance(context, ssl.SSLContext):
            raise TypeError(f"context must be an SSLContext, not {type(context).__name__}")
        if context.protocol == ssl.PROTOCOL_TLS_SERVER:
            raise ValueError("context must be a client's, not a server's")
        self._context = context

    def to_server(self, host: str, session: ssl.SSLSession | None = None) -> Tunnel:
        """Return the client's end of a tunnel, as `Security.to_server` does."""
        return Tunnel(self._context, server_name=name_of(host), session=session)

    def refusal(self, tunnel: Tunnel) -> str | None:
        """Return why a certificate is refused after a good handshake; None if it is not."""
        return expiry(tunnel)

    def acceptance(self) -> Acceptance:
        """Return what checks later whether the certificate of a connection is still valid."""
        return Acceptance(lambda: None)

    def warn_of_end(self) -> None:
        """Do nothing, because the certificate of an SSLContext cannot be read."""


# --- reloading ------------------------------------------------------------------------------

T = TypeVar("T")

# The exceptions for a mistake in a file, and for a file that cannot be read.
MISTAKES = (ImportError, OSError, TypeError, ValueError)


def read_secret(path: str | os.PathLike[str]) -> str:
    """Return the text of a file with a secret, up to 64 KiB; others must not be able to read it."""
    with open_file(path) as file:
        mode = os.fstat(file.fileno()).st_mode
        if os.name == "posix" and mode & stat.S_IROTH:
            reason = "all users of this machine can read this secret; chmod o= ends that"
            raise PermissionError(errno.EACCES, reason, os.fspath(path))
        return file.read(1 << 16).decode()  # a file that was named by mistake may have more


class _Reloadable(Protocol):
    def reload(self) -> None: ...


class RenewedValue(Generic[T]):
    """A value that `read` makes of files; it stays the former one while a file is wrong."""

    def __init__(self, read: Callable[[], T]) -> None:
        self._read = read
        self._logged = ""
        self.value: T = read()
        keep_renewed(self)

    def reload(self) -> None:
        """Read the files again; raise what `read` raises, and keep the value then."""
        self.value = self._read()

    def fresh(self) -> T:
        """Read the files again and return the value; log a mistake, and return the former value."""
        try:
            self.reload()
            self._logged = ""
        except MISTAKES as error:
            if self._logged != str(error):
                self._logged = str(error)
                logger.warning("the former content is used: %s", error)
        return self.value


_in_use: weakref.WeakSet[_Reloadable] = weakref.WeakSet()


def keep_renewed(reloadable: _Reloadable) -> None:
    """Let `reload_all` reload an object as long as it exists."""
    _in_use.add(reloadable)


def reload_all() -> list[str]:
    """Reload all certificates, keys and passwords, as on SIGHUP; return lines for the log."""
    lines: list[str] = []
    reloadables = list(_in_use)
    for reloadable in reloadables:
        try:
            reloadable.reload()
        except MISTAKES as error:
            lines.append(Problem(f"the former content is used: {error}"))
    return lines or ["certificates and passwords: read again"] * bool(reloadables)
