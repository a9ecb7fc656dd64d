"""
Answers that show by themselves that they are whole, and whose they are.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from ..protocol.framing import mbap, pdu_with_crc, pdu_with_header, rtu

if TYPE_CHECKING:
    from .options import Parts

__all__ = ["KNOWN", "PlainAnswers"]

KNOWN = frozenset(bytes([code]) for code in (1, 2, 3, 4, 5, 6, 15, 16, 17, 22, 23))
"""The functions that libmodbus has, as their codes stand in a PDU."""


PduIn = Callable[[bytes, int, int], bytes]

FrameOf = Callable[[int, int, bytes], bytes]


class PlainAnswers:
    """
    Recognises the answer to the only request that is in flight, in any framing but ASCII.

    Args:
        parts: of the client.

    Attributes:
        is_line: True if frames have no transaction ids.
        frame: returns the frame of a request; is called with its transaction id, which only some
            frames have, the unit, and the PDU.
        pdu_in: returns the PDU of an answer that is all that was received, or an empty one; is
            called with the bytes, the unit, and the transaction id.
    """

    def __init__(self, parts: Parts) -> None:
        self.is_line: bool = not parts.matching.has_ids
        self.frame: FrameOf = rtu if self.is_line else mbap
        self.pdu_in: PduIn = pdu_with_crc if self.is_line else pdu_with_header
