"""
Errors of OpenSSL in words.
"""

from __future__ import annotations

import ssl

__all__ = ["in_words"]

MEANINGS = {
    "WRONG_VERSION_NUMBER": "what answers there is no TLS; is it tcp://?",
    "UNSUPPORTED_PROTOCOL": "it speaks no TLS 1.2 or newer",
    "TLSV1_ALERT_PROTOCOL_VERSION": "it speaks no TLS 1.2 or newer",
    "SSLV3_ALERT_HANDSHAKE_FAILURE": "handshake failure: no cipher in common?",
}
"""Reason -> the probable cause at the server of a client."""


def in_words(error: ssl.SSLError, *, guess: bool = False) -> str:
    """
    Return an error as text.

    Args:
        guess: True to add the probable cause at the server, for the error of a client.
    """
    if isinstance(error, ssl.SSLCertVerificationError):
        return str(error.verify_message)
    reason = error.reason or str(error)
    found = MEANINGS.get(reason) if guess else None
    return found or reason.lower().replace("_", " ")
