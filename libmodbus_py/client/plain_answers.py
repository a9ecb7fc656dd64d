"""
Answers that show by themselves that they are whole, and whose they are.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from ..protocol.framing import Frame, make_framer, mbap, pdu_with_crc, pdu_with_header

if TYPE_CHECKING:
    from .options import Parts

__all__ = ["KNOWN", "PlainAnswers"]

KNOWN = frozenset(bytes([code]) for code in (1, 2, 3, 4, 5, 6, 15, 16, 17, 22, 23))
"""The functions that libmodbus has, as their codes stand in a PDU."""


PduIn = Callable[[bytes, int, int], bytes]

FrameOf = Callable[[int, int, bytes], bytes]


class PlainAnswers:
    """
    Recognises the answer to the only request that is in flight.

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
        framer = make_framer(parts.endpoint.framing, "client")
        self.is_line: bool = framer.has_broadcast
        encode = framer.encode
        self.frame: FrameOf = mbap
        self.pdu_in: PduIn = pdu_with_header
        if self.is_line:
            self.frame = lambda _, unit, pdu: encode(Frame(unit, pdu))
            self.pdu_in = pdu_with_crc
        self._silence = parts.port.silence
        self._matching = parts.matching

    def is_own(self, unit: int, request: bytes, answer: bytes, since: float, now: float) -> bool:
        """Return True unless an answer on a line may be that to an earlier request."""
        if now < self._silence.left_at:
            return False
        return self._matching.accepts(unit, request, answer, now - since)
