"""
Recognises answers whose frame shows that it is complete, and which request it answers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from ..protocol.framing import mbap, pdu_with_crc, pdu_with_header, rtu

if TYPE_CHECKING:
    from .options import Parts

__all__ = ["KNOWN", "PlainAnswers"]

KNOWN = frozenset(bytes([code]) for code in (1, 2, 3, 4, 5, 6, 15, 16, 17, 22, 23))
"""The function codes that libmodbus supports, as the first byte of a PDU."""


PduIn = Callable[[bytes, int, int], bytes]

FrameOf = Callable[[int, int, bytes], bytes]


class PlainAnswers:
    """
    Recognises the answer to the only request in flight, in any framing except ASCII.

    Args:
        parts: the parts of the client.

    Attributes:
        is_line: True if frames have no transaction ids.
        frame: called with the transaction id, which only some frames have, the unit and the PDU of
            a request; returns its frame.
        pdu_in: called with the received bytes, the unit and the transaction id; returns the PDU if
            the bytes are exactly one answer, else an empty one.
    """

    def __init__(self, parts: Parts) -> None:
        self.is_line: bool = not parts.matching.has_ids
        self.frame: FrameOf = rtu if self.is_line else mbap
        self.pdu_in: PduIn = pdu_with_crc if self.is_line else pdu_with_header
