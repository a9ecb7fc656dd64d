"""
Decoding of frames that are known to be requests or responses.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ...protocol.errors import ExceptionResponse, FrameError, InvalidResponse, ModbusError
from ...protocol.framing import Frame
from ...protocol.pdu import RawRequest, Request, decode_request
from .transaction import Kind, Transaction

__all__ = [
    "Ending",
    "answered",
    "damage_alone",
    "damaged",
    "decoded",
    "misused",
    "request_of",
    "unasked",
]


class Ending(NamedTuple):
    """The end of a request; the attributes are those of `Transaction`."""

    kind: Kind
    response: Any = None
    error: ModbusError | None = None


def decoded(pdu: bytes) -> Request[Any] | None:
    """
    Decode a request as a server does.

    Return a `RawRequest` for function codes without a class; None if a server refuses the PDU.
    """
    try:
        return decode_request(pdu)
    except ExceptionResponse as refusal:
        if refusal.code == 1 and 0 < pdu[0] < 0x80:
            return RawRequest.decode(pdu)
        return None


def request_of(pdu: bytes) -> Request[Any]:
    """Decode any request with a function code in 1..127; `RawRequest` if a server refuses it."""
    return decoded(pdu) or RawRequest.decode(pdu)


def answered(request: Request[Any], pdu: bytes) -> Ending:
    """Decode the response to a request as a client does."""
    try:
        return Ending("answered", request.decode_response(pdu))
    except ExceptionResponse as refusal:
        return Ending("exception", None, refusal)
    except InvalidResponse as error:
        error.received = pdu
        return Ending("invalid", None, error)


def damaged(data: bytes) -> Ending:
    """Return the outcome for bytes that were received instead of a response."""
    size = len(data)
    why = f"{size} bytes that are not a frame" if size > 1 else "a byte that is not a frame"
    return Ending("damaged", None, FrameError(why, received=data))


def damage_alone(began: float, data: bytes) -> Transaction:
    """Return the transaction for bytes that belong to no request."""
    return Transaction(began, "damaged", error=damaged(data).error)


def misused(began: float, frame: Frame) -> Transaction:
    """Return the transaction for a frame whose function code is not allowed."""
    code = frame.pdu[0]
    error = InvalidResponse(f"a frame with function code {code:02X}h", received=frame.pdu)
    return Transaction(began, "invalid", frame.unit, error=error)


def unasked(began: float, frame: Frame) -> Transaction:
    """Return the transaction for a response that belongs to no request."""
    unit, pdu, _ = frame
    function, response, error = pdu[0] & 0x7F, None, None
    if pdu[0] & 0x80 and len(pdu) == 2:
        error = ExceptionResponse.of(pdu[1], unit=unit, function=function)
    else:
        response = pdu[1:]
    return Transaction(began, "unasked", unit, function, response=response, error=error)
