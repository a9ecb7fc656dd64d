"""
What answers the requests of one connection or port while faults happen there.
"""

from __future__ import annotations

from ..protocol.framing import Frame, Framer, TcpFramer
from .faults.delivery import Delivery, pieces
from .limits import ServerStatistics
from .units import SerialUnits, TcpUnits

__all__ = ["FaultyAnswers"]


class FaultyAnswers:
    """
    Answers of devices, late, wrong, in pieces or not at all, as the faults of the units say.

    Args:
        units: who answers.
        framer: of the line.
        peer, role: who asks.
        statistics: where refusals are counted.
        delivery: takes the answers to who asks.
    """

    def __init__(
        self,
        units: TcpUnits | SerialUnits,
        framer: Framer,
        peer: str,
        role: str | None,
        statistics: ServerStatistics,
        delivery: Delivery,
    ) -> None:
        self.delivery: Delivery = delivery
        self._units = units
        self._framer = framer
        self._peer = peer
        self._role = role
        self._statistics = statistics

    def answer(self, request: Frame) -> None:
        """Execute a request, and have its answer sent as it becomes it."""
        if self.delivery.is_over:
            return
        fault = None
        faults = self._units.faults
        if faults is not None and self._units.answers(request):
            has_transaction = isinstance(self._framer, TcpFramer)
            fault = faults.due(request, has_transaction=has_transaction)
        if fault is not None and fault.code is not None:
            answer: Frame | None = self._units.refuse(request, fault.code)
        else:
            answer = self._units.answer(request, self._peer, self._role)
        if answer is not None:
            self._statistics.refused += answer.pdu[0] >> 7
            self.delivery.send(pieces(fault, answer, self._framer))
