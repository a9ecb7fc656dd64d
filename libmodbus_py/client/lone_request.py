"""
The short way of the asyncio client: one request in flight, whose answer shows by itself that it is
its own.

Like `shortcut` for blocking clients, it leads around the conversation while that has nothing to
decide. Whatever else happens before the answer is there, the request is handed over to the
conversation first, which goes on as if it had sent it. Serial lines do not go this way: their
answers come in pieces, and need silence between them.
"""

from __future__ import annotations

from ..protocol.errors import ModbusError
from .batch import Batch
from .options import Parts
from .plain_answers import KNOWN, PlainAnswers

__all__ = ["LoneRequest"]


class LoneRequest:
    """
    At most one request that was sent, and of which the conversation does not know.

    Args:
        parts: of the client.
        is_short: True if requests may be sent without asking `may_send` or keeping a pace.

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
        """When the timeout of the request is over, which may be changed; 0 without a request."""
        return 0.0 if self.batch is None else self._sent + self.batch.timeouts.timeout

    def takes(self, batch: Batch) -> bool:
        """Return True if the only request of a batch may be sent, and no other is in flight."""
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
        Send the request of a batch, and return when its timeout is over.

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
            False if the conversation must look at the bytes.
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
        except ModbusError:  # the conversation meets it again, and tells what was asked
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
