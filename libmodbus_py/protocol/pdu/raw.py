"""
Requests that are sent as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from ..checks import integer
from .fields import MAX_PDU, LengthRule, checked_data, unknown_length
from .request import Request


@dataclass(frozen=True, slots=True)
class RawRequest(Request[bytes]):
    """
    A request of any function, 1..127, with up to 252 bytes of `data` that are sent unchanged.

    The result is the bytes after the function code of the response. On RTU lines, a response
    without a length rule ends where its CRC fits.
    """

    function: int  # type: ignore[misc]  # here it is data, not the class's own
    data: bytes = b""

    request_length: ClassVar[LengthRule] = unknown_length
    response_length: ClassVar[LengthRule] = unknown_length

    def __post_init__(self) -> None:
        object.__setattr__(self, "function", integer("function", self.function, 1, 127))
        checked_data("data", self.data, MAX_PDU - 1)

    def encode(self) -> bytes:
        return bytes([self.function]) + self.data

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        return cls(pdu[0], pdu[1:])

    def encode_response(self, result: bytes) -> bytes:
        return bytes([self.function]) + checked_data("result", result, MAX_PDU - 1)

    def _decode_response(self, pdu: bytes) -> bytes:
        return pdu[1:]
