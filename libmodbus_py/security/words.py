"""
Errors of OpenSSL in words.
"""

from __future__ import annotations

import ssl

__all__ = ["in_words"]

MEANINGS = {
    "WRONG_VERSION_NUMBER": "what answers there is no TLS",
    "UNSUPPORTED_PROTOCOL": "it speaks no TLS 1.2 or newer",
    "TLSV1_ALERT_PROTOCOL_VERSION": "it speaks no TLS 1.2 or newer",
    "SSLV3_ALERT_HANDSHAKE_FAILURE": "handshake failure: no cipher in common?",
}
"""Reason -> what is probably wrong at the other side of a client."""


def in_words(error: ssl.SSLError, *, guess: bool = False) -> str:
    """
    Return what is wrong.

    Args:
        guess: for an error that a client meets, return what is probably wrong with the server.
    """
    if isinstance(error, ssl.SSLCertVerificationError):
        return str(error.verify_message)
    reason = error.reason or str(error)
    found = MEANINGS.get(reason) if guess else None
    return found or reason.lower().replace("_", " ")
