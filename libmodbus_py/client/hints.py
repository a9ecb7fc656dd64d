"""
Texts of errors: that no answer came, and which mistake is likely, as the received bytes show.
"""

from __future__ import annotations

import errno
import re

from ..ports.schemes import SCHEMES
from ..protocol.errors import MAX_RECEIVED, ModbusError, ModbusTimeoutError, in_hex
from ..protocol.framing import crc16, is_one_frame

__all__ = ["MAX_KEPT", "add_hint", "explain", "explain_end", "explain_role", "no_answer"]

MAX_KEPT = MAX_RECEIVED
"""The most received bytes that errors contain; more bytes would not help."""

PLAIN = tuple(scheme for scheme, (_, transport) in SCHEMES.items() if transport == "tcp")
"""The schemes of connections without TLS."""

ASCII_FRAME = rb":[0-9A-Fa-f]{6}"


def no_answer(timeout: float, received: bytes, *, is_held: bool = False) -> ModbusTimeoutError:
    """
    Return the error for a request that got no answer, with the bytes received instead.

    Args:
        is_held: True if an answer came, but too late to see whether another one follows (`Line`).
    """
    if is_held:
        return ModbusTimeoutError(
            f"within {timeout:g} s it is unknown whether {in_hex(received)} answers this request "
            "or an earlier one",
            received=received,
        )
    if received:
        return ModbusTimeoutError(
            f"no complete answer within {timeout:g} s, but {in_hex(received)}", received=received
        )
    return ModbusTimeoutError(f"no answer within {timeout:g} s")


def add_hint(error: ModbusError, hint: str) -> None:
    """Append a hint, unless it is empty, to the message of an error."""
    error.args = (f"{error.args[0]}; {hint}",) if hint else error.args


def explain(scheme: str, sent: bytes, received: bytes) -> str:
    """
    Return the likely mistake; an empty string if none is recognised.

    Args:
        scheme: the scheme of the endpoint's URL.
        sent: the request as it was sent.
        received: the received bytes, which are not an answer.
    """
    framing, _ = SCHEMES[scheme]  # type: ignore[index]
    if scheme in PLAIN and _looks_tls(received):
        return "this looks like tls://"
    if framing in ("rtu", "ascii") and received.startswith(sent):
        return "the request itself came back; echo=True?"
    for looks_so, other in _LOOKS.items():
        if other != framing and framing != "udp" and looks_so(received):
            is_on_tcp = scheme.endswith("tcp") and other != "tcp"
            return f"this looks like {other}{'+tcp' * is_on_tcp}://"
    if scheme == "rtu" and not _has_start(sent, received):
        return "only noise; baud rate, parity, A and B swapped?"
    return ""


def explain_end(scheme: str, number: int | None) -> str:
    """
    Return the likely mistake if a connection ended before any answer arrived over it.

    Args:
        scheme: the scheme of the endpoint's URL.
        number: the number of the error, or None.
    """
    is_ended = number in (errno.ECONNRESET, errno.EPIPE)
    return "nothing was answered yet; does it want tls://?" if scheme in PLAIN and is_ended else ""


def explain_role(certificate: bytes | None) -> str:
    """
    Return why a server may have refused a function: the role in the client's own certificate.

    Args:
        certificate: the certificate in DER; None without TLS, where there is no reason to give.
    """
    if certificate is None:
        return ""
    try:
        from ..security.role import role_of

        role = role_of(certificate)
    # Without cryptography, or a descriptor to import it; or the SSLContext was given.
    except (ImportError, OSError, ValueError):
        return "the server may allow it to other roles only"
    if role is None:
        return "the server may allow it to some roles only, and this certificate has none"
    return f"the server may allow it to other roles than {role!r}"


def _looks_tls(data: bytes) -> bool:
    """Return True if bytes begin like the header of a TLS record (RFC 8446, 5.1)."""
    return len(data) >= 5 and data[0] in range(20, 24) and data[1] == 3 and data[2] <= 4


def _looks_ascii(data: bytes) -> bool:
    return re.search(ASCII_FRAME, data) is not None


def _looks_rtu(data: bytes) -> bool:
    return any(crc16(data[:end]) == 0 for end in range(5, min(len(data), 256) + 1))


_LOOKS = {_looks_ascii: "ascii", is_one_frame: "tcp", _looks_rtu: "rtu"}


def _has_start(sent: bytes, received: bytes) -> bool:
    """Return True if the bytes contain the unit and the function of the request."""
    unit, function = sent[0], sent[1]
    starts = (bytes([unit, function]), bytes([unit, function | 0x80]))
    return any(start in received for start in starts)
