"""
What a frame says, once it is known whether it asks or answers.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ...protocol.errors import ExceptionResponse, FrameError, InvalidResponse, ModbusError
from ...protocol.pdu import RawRequest, Request, decode_request
from .transaction import Kind

__all__ = ["Outcome", "answered", "damaged", "decoded"]


class Outcome(NamedTuple):
    """How an answer decodes; as in `Transaction`."""

    kind: Kind
    response: Any = None
    error: ModbusError | None = None


def decoded(pdu: bytes) -> Request[Any] | None:
    """As a server does; what has no class is taken as it is, and what a server refuses is None."""
    try:
        return decode_request(pdu)
    except ExceptionResponse as refusal:
        if refusal.code == 1 and 0 < pdu[0] < 0x80:
            return RawRequest.decode(pdu)
        return None


def answered(request: Request[Any], pdu: bytes) -> Outcome:
    """As a client does."""
    try:
        return Outcome("answered", request.decode_response(pdu))
    except ExceptionResponse as refusal:
        return Outcome("exception", None, refusal)
    except InvalidResponse as error:
        error.received = pdu
        return Outcome("invalid", None, error)


def damaged(data: bytes) -> Outcome:
    """Bytes that came instead of an answer, or without a question."""
    size = len(data)
    why = f"{size} bytes that are no frame" if size > 1 else "a byte that is no frame"
    return Outcome("damaged", None, FrameError(why, received=data))
