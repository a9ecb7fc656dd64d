"""
Certificates that their authority has revoked: revocation lists (RFC 5280, section 5).

OpenSSL checks them when a connection begins. This file reads them too, for connections that were
open before a list was changed.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from .extra import require_cryptography
from .files import File, place_of, text_of

if TYPE_CHECKING:
    from datetime import datetime

    from cryptography import x509

__all__ = ["Revoked"]

LIST = re.compile("-----BEGIN X509 CRL-----.+?-----END X509 CRL-----", re.DOTALL)


class Revoked:
    """
    The revocation lists of a PEM file.

    Args:
        file: one or several lists.

    Attributes:
        ends: the earliest time at which a list ends, in seconds since 1970, after which OpenSSL
            refuses all certificates of its authority; None if no list tells.

    Raises:
        ImportError: cryptography is not installed.
        TypeError, ValueError: the file cannot be read, contains no list, or something else.
    """

    def __init__(self, file: File) -> None:
        require_cryptography()
        text = text_of("crl", file)
        if "-----BEGIN CERTIFICATE-----" in text:
            raise ValueError(f"{place_of('crl', file)} contains a certificate, which has no effect")
        self._lists = _lists(file, text)
        ends = [end for each in self._lists if (end := _end(each)) is not None]
        self.ends: float | None = min(ends, default=None)

    def any_of(self, certificates: Iterable[bytes]) -> bool:
        """
        Return True if a certificate is revoked.

        Args:
            certificates: X.509 in DER.
        """
        from cryptography import x509

        return any(
            each.issuer == certificate.issuer
            and each.get_revoked_certificate_by_serial_number(certificate.serial_number) is not None
            for certificate in map(x509.load_der_x509_certificate, certificates)
            for each in self._lists
        )


def _lists(file: File, text: str) -> list[x509.CertificateRevocationList]:
    from cryptography import x509

    try:
        lists = [x509.load_pem_x509_crl(pem.encode()) for pem in LIST.findall(text)]
    except ValueError:
        lists = []
    if not lists:
        raise ValueError(f"{place_of('crl', file)}: no revocation list in PEM format")
    return lists


def _end(each: Any) -> float | None:
    # Since version 42 there is one with a timezone, and the one without warns.
    with contextlib.suppress(AttributeError):
        aware: datetime | None = each.next_update_utc
        return aware.timestamp() if aware is not None else None
    from datetime import UTC

    naive: datetime | None = each.next_update
    return naive.replace(tzinfo=UTC).timestamp() if naive is not None else None
