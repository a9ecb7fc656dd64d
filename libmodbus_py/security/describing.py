"""
A certificate in one line of an error message.

Certificates come from peers that are not trusted yet: texts are cut, and characters that could harm
a terminal or log are escaped.
"""

from __future__ import annotations

import contextlib
import hashlib
import reprlib
from datetime import UTC, datetime
from typing import TYPE_CHECKING, NamedTuple

from .extra import require_cryptography

if TYPE_CHECKING:
    from cryptography import x509

__all__ = ["CertificateHolder", "describe", "end_of", "holder_of", "shown"]

SHOWN_TIME = "%Y-%m-%d %H:%M:%S"

_REPR = reprlib.Repr()
_REPR.maxstring = 100


def shown(what: object) -> str:
    """Quote text that may come from a peer: on one line, in 100 characters, nothing hidden."""
    return _REPR.repr(str(what))


def describe(certificate: bytes) -> str:
    """
    Return subject, issuer, validity and SHA-256 of a certificate.

    Without cryptography the result is the SHA-256, with a hint how to see more. Never raises,
    whatever the bytes are.

    Args:
        certificate: X.509 in DER.

    Returns:
        One line of printable characters, 500 at most. The SHA-256 is what ``openssl x509
        -fingerprint -sha256`` prints, without its colons.
    """
    fingerprint = f"SHA-256 {hashlib.sha256(certificate).hexdigest()}"
    try:
        require_cryptography()
    except ImportError:
        return f"{fingerprint} (more with: pip install 'libmodbus-py[security]')"
    from cryptography import x509

    try:
        return f"{_said(x509.load_der_x509_certificate(certificate))}, {fingerprint}"
    except Exception:
        return f"{len(certificate)} bytes that are not a certificate, {fingerprint}"


class CertificateHolder(NamedTuple):
    """
    The holder of a certificate.

    Attributes:
        subject: the name as in RFC 4514; empty for a nameless one, or without cryptography.
        serial: the serial number in hexadecimal digits, or without cryptography the SHA-256 of the
            certificate.
    """

    subject: str
    serial: str


def holder_of(certificate: bytes) -> CertificateHolder:
    """
    Return the holder of a certificate. Never raises, whatever the bytes are.

    Args:
        certificate: X.509 in DER.
    """
    try:
        require_cryptography()
        from cryptography import x509

        found = x509.load_der_x509_certificate(certificate)
        return CertificateHolder(found.subject.rfc4514_string(), f"{found.serial_number:x}")
    except Exception:
        return CertificateHolder("", hashlib.sha256(certificate).hexdigest())


def end_of(certificate: bytes) -> float | None:
    """
    Return the time at which a certificate ends, in seconds since 1970; None without cryptography.

    Args:
        certificate: X.509 in DER.
    """
    try:
        require_cryptography()
    except ImportError:
        return None
    from cryptography import x509

    return _time(x509.load_der_x509_certificate(certificate), "not_valid_after").timestamp()


def _said(certificate: x509.Certificate) -> str:
    begin, end = (_time(certificate, f"not_valid_{when}") for when in ("before", "after"))
    is_own = certificate.subject == certificate.issuer
    issuer = "self-signed" if is_own else f"issued by {_name(certificate.issuer)}"
    valid = f"{begin:{SHOWN_TIME}} to {end:{SHOWN_TIME}} UTC"
    return f"{_name(certificate.subject)}, {issuer}, valid {valid}"


def _name(name: x509.Name) -> str:
    return shown(name.rfc4514_string()) if name.rdns else "nameless"


def _time(certificate: x509.Certificate, name: str) -> datetime:
    # Since version 42 there is one with a timezone, and the one without warns.
    with contextlib.suppress(AttributeError):
        aware: datetime = getattr(certificate, f"{name}_utc")
        return aware
    naive: datetime = getattr(certificate, name)
    return naive.replace(tzinfo=UTC)
