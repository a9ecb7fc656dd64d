"""
The shortcut of asyncio clients: sends a single request without the conversation.

Like `shortcut` for blocking clients, it is used while the conversation has nothing to decide, and
if the frame of an answer shows which request it answers. If anything else happens before the answer
arrives, the request is first handed over to the conversation, which goes on as if it had sent the
request. Serial lines do not use this, because their answers arrive in pieces, and need silence
between them.
"""

from __future__ import annotations

from ..protocol.errors import ModbusError
from .batch import Batch
from .options import Parts
from .plain_answers import KNOWN, PlainAnswers

__all__ = ["LoneRequest"]


class LoneRequest:
    """
    The only request in flight, while the conversation does not know about it.

    Args:
        parts: the parts of the client.
        is_short: True if requests may be sent without calling `may_send` or keeping a pace.

    Attributes:
        batch: the request; None if there is none.
    """

    def __init__(self, parts: Parts, is_short: bool) -> None:
        self.batch: Batch | None = None
        self._port = parts.port
        self._conversation = parts.conversation
        self._capacity = parts.conversation.capacity
        self._matching = parts.matching
        self._statistics = parts.statistics
        self._answers = PlainAnswers(parts)
        self._is_line = self._answers.is_line
        self._is_short = is_short
        self._number = 0
        self._adu = b""
        self._sent = 0.0

    @property
    def until(self) -> float:
        """The time at which the timeout of the request ends; 0 without a request."""
        return 0.0 if self.batch is None else self._sent + self.batch.timeouts.timeout

    def takes(self, batch: Batch) -> bool:
        """Return True if a batch has one request, which may be sent now in this way."""
        return (
            self._is_short
            and batch.end == 1
            and batch.silent is None
            and (not self._is_line or batch.pdus[0][:1] in KNOWN)
            and self._conversation.is_plain
            and not (self._capacity.is_open and self._capacity.learns_from_one)
            and not self._port.has_input()
        )

    def send(self, batch: Batch, now: float) -> float:
        """
        Send the request of a batch, and return the time at which its timeout ends.

        Raises:
            ModbusConnectionError: the port is gone.
        """
        if not self._is_line:
            self._number = self._matching.next_number()
        self._adu = self._answers.frame(self._number, batch.unit, batch.pdus[0])
        self._matching.unasked = 0
        self._sent = now
        self._statistics.requests += 1
        self.batch = batch
        self._port.send([self._adu], now)
        return now + batch.timeouts.timeout

    def take(self, chunks: list[bytes], now: float) -> bool:
        """
        Settle the request if received bytes are its answer and nothing else.

        Returns:
            True if it was settled; False if the conversation must process the bytes.
        """
        batch = self.batch
        if batch is None or len(chunks) != 1:
            return False
        unit, request = batch.unit, batch.pdus[0]
        pdu = self._answers.pdu_in(chunks[0], unit, self._number)
        if pdu[:1] != request[:1]:
            return False
        if self._is_line and not self._matching.accepts(unit, request, pdu, self._sent, now):
            return False
        try:
            outcome = batch.requests[0].decode_response(pdu)
        except ModbusError:  # the conversation raises it again, with the request
            return False
        except BaseException as mistake:  # of the class of the request
            self._statistics.note(pdu[0], "invalid")
            outcome = mistake
        else:
            self._conversation.note_answer(pdu[0], "ok", now - self._sent, now)
        self.batch = None
        batch.settle(0, outcome)
        return True

    def hand_over(self) -> None:
        """Let the conversation expect the answer, as if it had sent the request."""
        batch, self.batch = self.batch, None
        if batch is not None:
            self._conversation.adopt(batch, self._adu, self._sent)
