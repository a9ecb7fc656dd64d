"""
Who one is, and whom one trusts.
"""

from __future__ import annotations

import hashlib
import os
import re
import ssl
from collections.abc import Iterable
from typing import Any, NoReturn

from .tunnel import Tunnel

__all__ = ["Security"]

File = str | os.PathLike[str]

# TLS 1.2 with the suites that ask for, and without those that
# forbid: Python's own list has SHA-1. What TLS 1.3 has is all good.
CIPHERS = "ECDHE+AESGCM:ECDHE+CHACHA20"

# OpenSSL's X509_V_FLAG_NO_CHECK_TIME, which Python does not name.
NO_CHECK_TIME = 0x200000

# Of a PEM file: five hundred authorities have room.
MAX_FILE = 1_000_000

CERTIFICATE = re.compile("-----BEGIN CERTIFICATE-----.+?-----END CERTIFICATE-----", re.DOTALL)

FINGERPRINT = re.compile("[0-9a-f]{64}")


class Security:
    """
    Who one is, and whom one trusts, for `tls://` at either end: Modbus/TCP Security v36.

    Both sides show a certificate and check the other's, TLS 1.2 or newer. With `trust` it must be
    signed by one of these authorities, in its time, and a server's must have its name. With
    `pin` it must be one of these very certificates, whoever signed it and however old it
    is: most devices in the field have made their own.

    Args:
        certificate: a PEM file with one's own certificate, and behind it the others
            of its chain (R-46).
        key: a PEM file with the private key; None if it is in the same file.
        trust: a PEM file with the authorities' certificates.
        pin: one or several certificates, each as a PEM file, or as the 64 hexadecimal digits
            of its SHA-256, with or without colons. A server needs files: Python's ssl can
            only take a certificate that it knows.
        server_name: the name or address that a server's certificate must have (`trust`);
            None for the host that a client connects to. Servers take no notice.
        password: of an encrypted key.

    Raises:
        TypeError, ValueError: a file that cannot be read or is none, a key that is not the
            certificate's or has another password, both or none of `trust` and `pin`.
    """

    def __init__(
        self,
        certificate: File,
        key: File | None = None,
        *,
        trust: File | None = None,
        pin: File | Iterable[File] | None = None,
        server_name: str | None = None,
        password: str | None = None,
    ) -> None:
        if (trust is None) == (pin is None):
            raise ValueError("security needs either trust, the authorities, or pin, certificates")
        for name, text in (("server_name", server_name), ("password", password)):
            if not isinstance(text, str | None):
                raise TypeError(f"{name} must be a string, not {type(text).__name__}")
        self._certificate = certificate
        self._key = key
        self._password = password
        self._is_encrypted = False
        self._trust = trust
        self._pins = None if pin is None else _pins(pin)
        self._server_name = server_name
        self.own: bytes = _certificates("certificate", certificate)[0]
        self._client = self._make_client()
        self._server: ssl.SSLContext | None = None
        self._check_server_name()

    def __repr__(self) -> str:
        whom = f"trust={os.fspath(self._trust)!r}" if self._trust is not None else "pin=..."
        return f"Security({os.fspath(self._certificate)!r}, {whom})"

    # --- tunnels ------------------------------------------------------------------------------

    def to_server(self, host: str, session: ssl.SSLSession | None = None) -> Tunnel:
        """
        Make the client's end.

        Args:
            host: where it leads.
            session: of an earlier tunnel there, to resume.
        """
        name = _server_name(self._server_name or host)
        return Tunnel(self._client, server_name=name, session=session)

    def check_server(self) -> None:
        """
        Make ready for `to_client`.

        Raises:
            ValueError: a pin without its certificate.
        """
        if self._server is None:
            self._server = self._make_server()

    def to_client(self) -> Tunnel:
        """Make the server's end; see `check_server`."""
        assert self._server is not None
        return Tunnel(self._server)

    @property
    def is_pinned(self) -> bool:
        """Whether it is these very certificates that are trusted, however old."""
        return self._pins is not None

    def accepts(self, certificate: bytes) -> bool:
        """Whether what a good handshake showed is one of the pins, if there are any."""
        return self._pins is None or _digest(certificate) in self._pins

    def _check_server_name(self) -> None:
        if self._server_name is None:
            return
        try:
            Tunnel(self._client, server_name=_server_name(self._server_name))
        except (ValueError, TypeError, ssl.SSLError):
            shown = repr(self._server_name)
            raise ValueError(f"server_name must be a name or an address, not {shown}") from None

    # --- contexts -----------------------------------------------------------------------------

    def _own_context(self, protocol: int) -> ssl.SSLContext:
        context = ssl.SSLContext(protocol)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.set_ciphers(CIPHERS)
        context.options |= ssl.OP_NO_COMPRESSION | ssl.OP_NO_RENEGOTIATION
        try:
            context.load_cert_chain(self._certificate, self._key, self._ask_for_password)
        except ssl.SSLError as error:
            raise ValueError(f"{self._key_place()}: {self._reason_of_key(error)}") from None
        except OSError as error:
            raise ValueError(f"{self._key_place()}: {error.strerror}") from None
        return context

    def _ask_for_password(self) -> str:
        """OpenSSL asks only if the key is encrypted; without an answer it would ask the user."""
        if self._password is None:
            raise ValueError(f"{self._key_place()} is encrypted, and needs its password")
        self._is_encrypted = True
        return self._password

    def _reason_of_key(self, error: ssl.SSLError) -> str:
        if error.reason == "KEY_VALUES_MISMATCH":
            return "not the key of the certificate"
        if error.reason:
            return error.reason.lower().replace("_", " ")
        # All that OpenSSL says is "PEM lib".
        return "the password is another" if self._is_encrypted else "no key in PEM format"

    def _key_place(self) -> str:
        return f"key {os.fspath(self._key if self._key is not None else self._certificate)!r}"

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


def _server_name(host: str) -> str:
    return host.partition("%")[0]  # an IPv6 address's zone is no part of its name


def _certificates(name: str, file: File) -> list[bytes]:
    """The certificates of a PEM file."""
    if not isinstance(file, str | os.PathLike):
        raise TypeError(f"{name} must be a file, not {type(file).__name__}")
    place = f"{name} {os.fspath(file)!r}"
    try:
        with open(file, encoding="ascii", errors="replace") as opened:
            text = opened.read(MAX_FILE + 1)
    except OSError as error:
        raise ValueError(f"{place}: {error.strerror}") from None
    if len(text) > MAX_FILE:
        raise ValueError(f"{place}: more than {MAX_FILE} bytes")
    try:
        found = [ssl.PEM_cert_to_DER_cert(pem) for pem in CERTIFICATE.findall(text)]
    except ValueError:
        _refuse(place)
    if not found:
        _refuse(place)
    return found


def _refuse(place: str) -> NoReturn:
    raise ValueError(f"{place}: no certificate in PEM format")


def _pins(given: Any) -> dict[str, bytes]:
    """SHA-256 -> the certificate, or nothing where only that is known."""
    several = isinstance(given, Iterable) and not isinstance(given, str)
    each: object
    pins: dict[str, bytes] = {}
    for each in given if several else [given]:
        if not isinstance(each, str | os.PathLike):
            raise TypeError(f"pin must be a file or a SHA-256, not {type(each).__name__}")
        digest = os.fspath(each).replace(":", "").lower()
        if FINGERPRINT.fullmatch(digest):
            pins.setdefault(digest, b"")
        else:
            certificate = _certificates("pin", each)[0]
            pins[_digest(certificate)] = certificate
    if not pins:
        raise ValueError("pin must be one certificate at least")
    return pins


def _digest(certificate: bytes) -> str:
    return hashlib.sha256(certificate).hexdigest()
