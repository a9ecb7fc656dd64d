"""
Answers of devices to one connection or port, as the faults of the units make them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from ...protocol.framing import Frame, Framer, TcpFramer
from ..limits import ServerStatistics
from .delivery import Delivery, fragments
from .due import Faults

__all__ = ["FaultyAnswers"]


class FaultyUnits(Protocol):
    """The devices of a line, some of which have faults."""

    @property
    def faults(self) -> Faults | None: ...

    def answers(self, frame: Frame) -> bool:
        """Return True if a request is answered."""
        ...

    def refuse(self, frame: Frame, code: int) -> Frame:
        """Answer a request that is answered with an exception, without executing it."""
        ...


class FaultyAnswers:
    """
    Answers that come late, wrong, in fragments or not at all.

    Args:
        units: the devices, and their faults.
        framer: of the line.
        answer: executes a request on the devices.
        statistics: where refusals are counted.
        delivery: takes the answers to the client.
    """

    def __init__(
        self,
        units: FaultyUnits,
        framer: Framer,
        answer: Callable[[Frame], Frame | None],
        statistics: ServerStatistics,
        delivery: Delivery,
    ) -> None:
        self.delivery: Delivery = delivery
        self._units = units
        self._framer = framer
        self._answer = answer
        self._statistics = statistics

    def answer(self, request: Frame) -> None:
        """Execute a request, and deliver its answer as the fault that is due makes it."""
        fault = None
        faults = self._units.faults
        if faults is not None and self._units.answers(request):
            has_transaction = isinstance(self._framer, TcpFramer)
            fault = faults.due(request, has_transaction=has_transaction)
        if fault is not None and fault.code is not None:
            answer: Frame | None = self._units.refuse(request, fault.code)
        else:
            answer = self._answer(request)
        if answer is not None:
            self._statistics.refused += answer.pdu[0] >> 7
            self.delivery.send(fragments(fault, answer, self._framer))
