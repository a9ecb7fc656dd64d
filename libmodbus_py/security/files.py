"""
The files of Modbus Security in PEM format: certificates, keys, pins and revocation lists.
"""

from __future__ import annotations

import os
import re
import ssl
from collections.abc import Iterable
from typing import TypeAlias

from .describing import digest_of, require_cryptography, time_in

__all__ = ["File", "PemFile", "Revoked", "read_pins"]

File: TypeAlias = str | os.PathLike[str]


class PemFile:
    """A file that an argument names; ``str`` returns both, as error messages name it."""

    def __init__(self, argument: str, path: File) -> None:
        if not isinstance(path, str | os.PathLike):
            raise TypeError(f"{argument} must be a file, not {type(path).__name__}")
        self._argument = argument
        self.path: File = path

    def __str__(self) -> str:
        return f"{self._argument} {os.fspath(self.path)!r}"

    def text(self) -> str:
        """Return the content; raise a ValueError if it cannot be read."""
        try:
            with open(self.path, encoding="utf-8", errors="replace") as opened:
                return opened.read()
        except OSError as error:
            raise ValueError(f"{self}: {error.strerror}") from None
        except ValueError as error:  # a name that no file can have
            raise ValueError(f"{self}: {error}") from None

    def certificates(self) -> list[bytes]:
        """Return the certificates in DER; raise a ValueError if there is none, or a list."""
        text = self.text()
        if "-----BEGIN X509 CRL-----" in text:
            raise ValueError(f"{self} contains a revocation list, which must be given as crl")
        try:
            found = [ssl.PEM_cert_to_DER_cert(pem) for pem in _parts(text, "CERTIFICATE")]
            reader = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
            for certificate in found:
                reader.load_verify_locations(cadata=certificate)
        except (ssl.SSLError, ValueError):
            found = []
        if not found:
            raise ValueError(f"{self}: no certificate in PEM format")
        return found


def _parts(text: str, kind: str) -> list[str]:
    return re.findall(f"-----BEGIN {kind}-----.+?-----END {kind}-----", text, re.DOTALL)


def read_pins(pins: Iterable[File]) -> dict[str, bytes]:
    """
    Return SHA-256 -> certificate in DER; empty bytes where only the SHA-256 is given.

    Raises:
        TypeError, ValueError: a pin is neither a file with a certificate nor a SHA-256, or there
            is none.
    """
    found: dict[str, bytes] = {}
    for pin in pins:
        if not isinstance(pin, str | os.PathLike):
            raise TypeError(f"pin must be a file or a SHA-256, not {type(pin).__name__}")
        digest = os.fspath(pin).replace(":", "").lower()
        if not re.fullmatch("[0-9a-f]{32,}", digest):  # no file has such a name
            certificate = PemFile("pin", pin).certificates()[0]
            found[digest_of(certificate)] = certificate
        elif len(digest) == 64:
            found.setdefault(digest, b"")
        else:
            digits = len(digest)
            raise ValueError(f"pin {os.fspath(pin)!r}: a SHA-256 has 64 digits, not {digits}")
    if not found:
        raise ValueError("pin must contain at least one certificate")
    return found


class Revoked:
    """
    The revocation lists of a file (RFC 5280, section 5).

    OpenSSL checks them when a connection begins. They are read here, too, for connections that
    were open before a list was changed.

    Attributes:
        ends: the earliest time at which a list ends, in seconds since 1970, after which OpenSSL
            refuses all certificates of its authority; None if no list tells.
    """

    def __init__(self, file: PemFile) -> None:
        require_cryptography()
        from cryptography import x509

        text = file.text()
        if "-----BEGIN CERTIFICATE-----" in text:
            raise ValueError(f"{file} contains a certificate, which has no effect")
        try:
            self._lists = [x509.load_pem_x509_crl(pem.encode()) for pem in _parts(text, "X509 CRL")]
        except ValueError:
            self._lists = []
        if not self._lists:
            raise ValueError(f"{file}: no revocation list in PEM format")
        ends = [time_in(revoked, "next_update") for revoked in self._lists]
        self.ends: float | None = min((end.timestamp() for end in ends if end), default=None)

    def any_of(self, certificates: Iterable[bytes]) -> bool:
        """Return True if one of the certificates, in DER, is revoked."""
        from cryptography import x509

        return any(
            revoked.issuer == found.issuer
            and revoked.get_revoked_certificate_by_serial_number(found.serial_number) is not None
            for found in map(x509.load_der_x509_certificate, certificates)
            for revoked in self._lists
        )
