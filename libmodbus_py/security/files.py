"""
The files of Modbus Security: certificates, keys and pins in PEM format.
"""

from __future__ import annotations

import hashlib
import os
import re
import ssl
from collections.abc import Iterable
from typing import Any

__all__ = ["File", "certificates_of", "digest_of", "has_key", "pins_of", "place_of", "text_of"]

File = str | os.PathLike[str]

# The most characters of a PEM file: enough for five hundred authorities.
MAX_FILE = 1_000_000

CERTIFICATE = re.compile("-----BEGIN CERTIFICATE-----.+?-----END CERTIFICATE-----", re.DOTALL)

PRIVATE_KEY = re.compile("-----BEGIN [A-Z ]*PRIVATE KEY-----")

# Content that would have no effect in a file of certificates, and what to do with it.
WITHOUT_EFFECT = {
    "-----BEGIN X509 CRL-----": "contains a revocation list, which must be given as crl",
    "-----BEGIN TRUSTED CERTIFICATE-----": "contains a trusted certificate of OpenSSL, whose rules"
    " would be ignored; convert it with openssl x509",
}

FINGERPRINT = re.compile("[0-9a-f]{64}")

# A text that was meant as a SHA-256, because no file has such a name.
LIKE_A_FINGERPRINT = re.compile("[0-9a-f]{32,}")


def place_of(name: str, file: File) -> str:
    """Return an argument and its file, for error messages."""
    return f"{name} {os.fspath(file)!r}"


def text_of(name: str, file: File) -> str:
    """
    Return the content of a file.

    Args:
        name: the argument that names the file, for errors.

    Raises:
        TypeError, ValueError: the file cannot be read, or is too large.
    """
    if not isinstance(file, str | os.PathLike):
        raise TypeError(f"{name} must be a file, not {type(file).__name__}")
    try:
        with open(file, encoding="utf-8", errors="replace") as opened:
            text = opened.read(MAX_FILE + 1)
    except OSError as error:
        raise ValueError(f"{place_of(name, file)}: {error.strerror}") from None
    except ValueError as error:  # a name that none can have
        raise ValueError(f"{place_of(name, file)}: {error}") from None
    if len(text) > MAX_FILE:
        raise ValueError(f"{place_of(name, file)}: more than {MAX_FILE} bytes")
    return text


def certificates_of(name: str, file: File) -> list[bytes]:
    """
    Return the certificates of a PEM file in DER, at least one.

    Raises:
        TypeError, ValueError: as for `text_of`; there is no certificate, or content that would be
            ignored.
    """
    text = text_of(name, file)
    for mark, reason in WITHOUT_EFFECT.items():
        if mark in text:
            raise ValueError(f"{place_of(name, file)} {reason}")
    found = CERTIFICATE.findall(text)
    try:
        certificates = [ssl.PEM_cert_to_DER_cert(pem) for pem in found]
        reader = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        for certificate in certificates:
            reader.load_verify_locations(cadata=certificate)
    except (ssl.SSLError, ValueError):
        certificates = []
    if not certificates:
        raise ValueError(f"{place_of(name, file)}: no certificate in PEM format")
    return certificates


def has_key(name: str, file: File) -> bool:
    """Return True if a PEM file contains a private key."""
    return PRIVATE_KEY.search(text_of(name, file)) is not None


def pins_of(given: Any) -> dict[str, bytes]:
    """
    Return SHA-256 -> certificate; empty bytes where only the SHA-256 is known.

    Raises:
        TypeError, ValueError: a pin is neither a file with a certificate nor a SHA-256.
    """
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
            certificate = certificates_of("pin", each)[0]
            pins[digest_of(certificate)] = certificate
    if not pins:
        raise ValueError("pin must contain at least one certificate")
    return pins


def digest_of(certificate: bytes) -> str:
    """Return the SHA-256 of a certificate, in hexadecimal digits."""
    return hashlib.sha256(certificate).hexdigest()
