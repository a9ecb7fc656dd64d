"""
A request as a gateway forwards it: its bytes, and its decoded form if its function is known.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from ...device.access import Touched, Who, touched
from ...protocol import pdu
from ...protocol.errors import ExceptionResponse, IllegalDataValue, IllegalFunction

__all__ = ["RequestBytes", "request_of"]

# Pollers send the same requests again and again.
REMEMBERED = 512

READS = (
    pdu.ReadCoils,
    pdu.ReadDiscreteInputs,
    pdu.ReadHoldingRegisters,
    pdu.ReadInputRegisters,
)
"""Requests that change nothing, and may be answered from the cache."""


class RequestBytes(pdu.Request[bytes]):
    """
    Any request PDU, unchanged; its result is the response PDU.

    The response to a known function must be valid, or InvalidResponse is raised. The response to
    another function must begin with the code of the function.

    Args:
        data: the PDU, 1..253 bytes.
        known: the decoded request; None if it cannot be decoded.

    Attributes:
        is_read: True if it reads a table and does nothing else.
        changes: True if it may change a device, as one that cannot be decoded may.
    """

    # fmt: off
    __slots__ = (
        "changes", "expects_response", "function", "is_read", "known", "may_be_broadcast", "pdu",
        "repeatable",
    )
    # fmt: on

    def __init__(self, data: bytes, known: pdu.Request[Any] | None) -> None:
        self.pdu: bytes = data
        self.known: pdu.Request[Any] | None = known
        self.function: int = data[0]  # type: ignore[misc]  # here it is data, not the class's own
        self.is_read: bool = isinstance(known, READS)
        is_write = known is not None and known.may_be_broadcast
        self.may_be_broadcast: bool = is_write  # type: ignore[misc]
        self.repeatable: bool = known is not None and known.repeatable  # type: ignore[misc]
        self.changes: bool = known is None or known.changes
        self.expects_response: bool = known is None or known.expects_response

    def touches(self, who: Who) -> Touched:
        """Return the addresses in tables that the request writes and reads."""
        return touched(self.known, who)

    def encode(self) -> bytes:
        return self.pdu

    def decode_response(self, pdu: bytes) -> bytes:
        if self.known is not None:
            self.known.decode_response(pdu)
        elif not pdu or pdu[0] != self.function:
            raise self._refusal(pdu)
        return pdu

    def response_to_broadcast(self) -> bytes:
        """Return the response of a device to this write if it were not a broadcast."""
        assert self.known is not None
        return self.known.encode_response(None)

    def __str__(self) -> str:
        if self.known is not None:
            return str(self.known)
        return f"a request of {len(self.pdu)} bytes"


@lru_cache(REMEMBERED)
def request_of(data: bytes) -> RequestBytes:
    """
    Return a request PDU as a request that can be forwarded.

    Only its length is checked. All else is left to the device, which may have more functions
    and ranges than the specification.

    Raises:
        IllegalFunction: no function can have this code.
        IllegalDataValue: a known function has no request of this length, so that the end of
            the request could not be found on a serial line.
    """
    if not 1 <= data[0] <= 0x7F:
        raise IllegalFunction(f"no function {data[0]}", function=data[0])
    if pdu.request_length(data) not in (len(data), 0):
        raise IllegalDataValue(f"a request of {len(data)} bytes", function=data[0])
    try:
        return RequestBytes(data, pdu.decode_request(data))
    except ExceptionResponse:
        return RequestBytes(data, None)
