"""
The own certificate and key, and the certificates that are trusted.
"""

from __future__ import annotations

import hashlib
import os
import re
import ssl
from collections.abc import Iterable
from typing import Any

from .tunnel import Tunnel, expiry, name_of
from .words import in_words

__all__ = ["Security"]

File = str | os.PathLike[str]

# TLS 1.2 with the suites that ask for, and without those that
# forbid: Python's own list has SHA-1. What TLS 1.3 has is all good.
CIPHERS = "ECDHE+AESGCM:ECDHE+CHACHA20"

# OpenSSL's X509_V_FLAG_NO_CHECK_TIME, which Python does not name.
NO_CHECK_TIME = 0x200000

# Of a PEM file: five hundred authorities have room.
MAX_FILE = 1_000_000

# Errors of OpenSSL for a key that does not match the certificate; the second: of another kind.
OF_ANOTHER_CERTIFICATE = ("KEY_VALUES_MISMATCH", "NO_CERTIFICATE_ASSIGNED")

# Errors of OpenSSL for a certificate that is too weak for its security level.
TOO_WEAK = ("EE_KEY_TOO_SMALL", "CA_KEY_TOO_SMALL", "CA_MD_TOO_WEAK")

CERTIFICATE = re.compile("-----BEGIN CERTIFICATE-----.+?-----END CERTIFICATE-----", re.DOTALL)

PRIVATE_KEY = re.compile("-----BEGIN [A-Z ]*PRIVATE KEY-----")

FINGERPRINT = re.compile("[0-9a-f]{64}")

# A text that was meant as a SHA-256, because no file has such a name.
LIKE_A_FINGERPRINT = re.compile("[0-9a-f]{32,}")

# The length that OpenSSL accepts.
MAX_PASSWORD = 1024


class Security:
    """
    The own certificate and the trusted ones, for `tls://` at either end: Modbus/TCP Security v36.

    Both sides show a certificate and check the other's, TLS 1.2 or newer. With `trust` the other
    side's certificate must be signed by one of these authorities and valid now, and a server's must
    have its name. With `pin` it must be one of exactly these certificates, with any signature and
    age: most devices in the field have signed their own.

    Args:
        certificate: a PEM file with one's own certificate, and behind it the others
            of its chain (R-46).
        key: a PEM file with the private key; None if it is in the same file.
        trust: a PEM file with the authorities' certificates.
        pin: one or several certificates, each as a PEM file, or as the 64 hexadecimal digits
            of its SHA-256, with or without colons. A server needs files: Python's ssl can
            only take a certificate that it knows.
        server_name: the name or address that a server's certificate must have (`trust`);
            None for the host that a client connects to. Servers ignore it.
        password: of an encrypted key.
        cert, ca: `certificate` and `trust` under the names that they have in URLs.

    Raises:
        TypeError, ValueError: a file that cannot be read or has wrong content, a key that is not
            the certificate's or has another password, both or none of `trust` and `pin`.
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
        cert: File | None = None,
        ca: File | None = None,
    ) -> None:
        own = _either("certificate", certificate, "cert", cert)
        if own is None:
            raise TypeError("security needs certificate, a PEM file with one's own certificate")
        trust = _either("trust", trust, "ca", ca)
        if (trust is None) == (pin is None):
            raise ValueError("security needs either trust, the authorities, or pin, certificates")
        for name, text in (("server_name", server_name), ("password", password)):
            if text is not None and not isinstance(text, str):
                raise TypeError(f"{name} must be a string, not {type(text).__name__}")
        if password is not None and len(password.encode()) > MAX_PASSWORD:
            raise ValueError(f"password must have {MAX_PASSWORD} bytes of UTF-8 at most")
        self._certificate = own
        self._key = key
        self._password = password
        self._trust = trust
        self._pins = None if pin is None else _pins(pin)
        self._server_name = server_name
        self.own: bytes = _certificates("certificate", own)[0]
        self._check_key()
        self._client = self._make_client()
        self._server: ssl.SSLContext | None = None
        if server_name is not None:
            self._check_server_name(server_name)

    def __repr__(self) -> str:
        whom = f"trust={os.fspath(self._trust)!r}" if self._trust is not None else "pin=..."
        return f"Security({os.fspath(self._certificate)!r}, {whom})"

    # --- tunnels ------------------------------------------------------------------------------

    def to_server(self, host: str, session: ssl.SSLSession | None = None) -> Tunnel:
        """
        Return the client's end of a tunnel.

        Args:
            host: the host of the server.
            session: the session of an earlier tunnel to it, to resume.
        """
        name = host if self._server_name is None else self._server_name
        return Tunnel(self._client, server_name=name_of(name), session=session)

    def check_server(self) -> None:
        """
        Check that `to_client` can be called.

        Raises:
            ValueError: a pin is given without its certificate.
        """
        if self._server is None:
            self._server = self._make_server()

    def to_client(self) -> Tunnel:
        """Return the server's end of a tunnel; see `check_server`."""
        assert self._server is not None
        return Tunnel(self._server)

    def refusal(self, tunnel: Tunnel) -> str | None:
        """Return why a certificate is refused after a good handshake; None if it is not."""
        if self._pins is None:
            return expiry(tunnel)
        # A pinned certificate is trusted even if it has expired.
        return None if self.accepts(tunnel.certificate) else "it is none of the pins"

    def accepts(self, certificate: bytes) -> bool:
        """Return True if a certificate is one of the pins, or there are none."""
        return self._pins is None or _digest(certificate) in self._pins

    # --- contexts -----------------------------------------------------------------------------

    def _own_context(self, protocol: int) -> ssl.SSLContext:
        context = ssl.SSLContext(protocol)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.set_ciphers(CIPHERS)
        context.options |= ssl.OP_NO_COMPRESSION | ssl.OP_NO_RENEGOTIATION
        was_asked = False

        def password() -> str:
            # Called only if the key is encrypted; without a password OpenSSL would ask the user.
            nonlocal was_asked
            was_asked = True
            if self._password is None:
                raise ValueError(f"{self._key_place()} is encrypted, and needs its password")
            return self._password

        try:
            context.load_cert_chain(self._certificate, self._key, password)
        except ssl.SSLError as error:
            raise ValueError(self._what_is_wrong(error, was_encrypted=was_asked)) from None
        except OSError as error:  # the file was there a moment ago
            raise ValueError(f"{self._key_place()}: {error.strerror}") from None
        return context

    def _what_is_wrong(self, error: ssl.SSLError, *, was_encrypted: bool) -> str:
        reason = in_words(error) if error.reason else "cannot be read"
        if error.reason in TOO_WEAK:
            return f"{_place('certificate', self._certificate)}: {reason}"
        if error.reason in OF_ANOTHER_CERTIFICATE:
            reason = "not the key of the certificate"
        elif was_encrypted:
            reason = "the password is another"
        return f"{self._key_place()}: {reason}"

    def _key_place(self) -> str:
        return _place("key", self._certificate if self._key is None else self._key)

    def _check_key(self) -> None:
        file = self._certificate if self._key is None else self._key
        if not PRIVATE_KEY.search(_text("key", file)):
            raise ValueError(f"{self._key_place()}: no key in PEM format")

    def _check_server_name(self, name: str) -> None:
        try:
            self.to_server(name)
        except (TypeError, ValueError, ssl.SSLError):
            text = f"server_name must be a name or an address, not {name!r}"
            raise ValueError(text) from None

    def _make_client(self) -> ssl.SSLContext:
        context = self._own_context(ssl.PROTOCOL_TLS_CLIENT)
        if self._pins is not None:  # looked at when the handshake is over
            context.check_hostname = False
            context.verify_mode = ssl.CERT_NONE
        else:
            self._load_trust(context)
        return context

    def _make_server(self) -> ssl.SSLContext:
        context = self._own_context(ssl.PROTOCOL_TLS_SERVER)
        context.verify_mode = ssl.CERT_REQUIRED  # R-06..10
        context.num_tickets = 1
        if self._pins is None:
            self._load_trust(context)
            return context
        unknown = [digest for digest, certificate in self._pins.items() if not certificate]
        if unknown:
            raise ValueError(f"pin {unknown[0]}: a server needs the certificate, a PEM file")
        for certificate in self._pins.values():
            context.load_verify_locations(cadata=certificate)
        partial = ssl.VerifyFlags.VERIFY_X509_PARTIAL_CHAIN | NO_CHECK_TIME
        context.verify_flags |= ssl.VerifyFlags(partial)
        return context

    def _load_trust(self, context: ssl.SSLContext) -> None:
        assert self._trust is not None
        for certificate in _certificates("trust", self._trust):
            context.load_verify_locations(cadata=certificate)


def _either(name: str, value: File | None, other_name: str, other: File | None) -> File | None:
    """Return the value of an argument that has two names."""
    if value is not None and other is not None:
        raise TypeError(f"{name} and {other_name} are the same argument, and both are given")
    return other if value is None else value


def _certificates(name: str, file: File) -> list[bytes]:
    """Return the certificates of a PEM file, at least one."""
    found = CERTIFICATE.findall(_text(name, file))
    try:
        certificates = [ssl.PEM_cert_to_DER_cert(pem) for pem in found]
        reader = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        for certificate in certificates:
            reader.load_verify_locations(cadata=certificate)
    except (ssl.SSLError, ValueError):
        certificates = []
    if not certificates:
        raise ValueError(f"{_place(name, file)}: no certificate in PEM format")
    return certificates


def _text(name: str, file: File) -> str:
    """Return the content of a file."""
    if not isinstance(file, str | os.PathLike):
        raise TypeError(f"{name} must be a file, not {type(file).__name__}")
    try:
        with open(file, encoding="utf-8", errors="replace") as opened:
            text = opened.read(MAX_FILE + 1)
    except OSError as error:
        raise ValueError(f"{_place(name, file)}: {error.strerror}") from None
    except ValueError as error:  # a name that none can have
        raise ValueError(f"{_place(name, file)}: {error}") from None
    if len(text) > MAX_FILE:
        raise ValueError(f"{_place(name, file)}: more than {MAX_FILE} bytes")
    return text


def _place(name: str, file: File) -> str:
    return f"{name} {os.fspath(file)!r}"


def _pins(given: Any) -> dict[str, bytes]:
    """Return SHA-256 -> certificate; empty bytes where only the SHA-256 is known."""
    several = isinstance(given, Iterable) and not isinstance(given, str)
    each: object
    pins: dict[str, bytes] = {}
    for each in given if several else [given]:
        if not isinstance(each, str | os.PathLike):
            raise TypeError(f"pin must be a file or a SHA-256, not {type(each).__name__}")
        digest = os.fspath(each).replace(":", "").lower()
        if FINGERPRINT.fullmatch(digest):
            pins.setdefault(digest, b"")
        elif LIKE_A_FINGERPRINT.fullmatch(digest):
            digits = len(digest)
            raise ValueError(f"pin {os.fspath(each)!r}: a SHA-256 has 64 digits, not {digits}")
        else:
            certificate = _certificates("pin", each)[0]
            pins[_digest(certificate)] = certificate
    if not pins:
        raise ValueError("pin must be one certificate at least")
    return pins


def _digest(certificate: bytes) -> str:
    return hashlib.sha256(certificate).hexdigest()
