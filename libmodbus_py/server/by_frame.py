"""
Devices answer what one connection or one port received, frame by frame.
"""

from __future__ import annotations

from collections.abc import Callable

from ..protocol.framing import AsciiFramer, Frame, Framing, TcpFramer
from .faults import Delivery, pieces
from .framed import Framed
from .limits import ServerStatistics
from .units import SerialUnits, TcpUnits

__all__ = ["ByFrame"]


class ByFrame(Framed):
    """
    Any framing, frame by frame.

    Args:
        units: who answers.
        framing, peer, statistics, write, follow, role, at_once: as of `Framed`.
    """

    def __init__(
        self,
        units: TcpUnits | SerialUnits,
        framing: Framing,
        peer: str,
        statistics: ServerStatistics,
        write: Callable[[bytes], None],
        follow: Callable[[], None] = lambda: None,
        role: str | None = None,
        at_once: int | None = None,
    ) -> None:
        super().__init__(framing, peer, statistics, write, follow, role, at_once)
        self._units = units
        # Only with faults do answers leave at other times than they are found.
        self._delivery = Delivery(write, follow) if units.faults else None
        self._end_request()

    @property
    def is_waiting(self) -> bool:
        return self.is_behind or (self._delivery is not None and self._delivery.is_waiting)

    def close(self) -> None:
        super().close()
        if self._delivery is not None:
            self._delivery.close()

    def _answer(self, request: Frame) -> Frame | None:
        if self._delivery is not None:
            self._answer_with_faults(request, self._delivery)
            return None
        return self._units.answer(request, self._peer, self._role)

    def _answer_with_faults(self, request: Frame, delivery: Delivery) -> None:
        fault = None
        if self._units.faults is not None and self._units.answers(request):
            has_transaction = isinstance(self._framer, TcpFramer)
            fault = self._units.faults.due(request, has_transaction=has_transaction)
        if fault is not None and fault.code is not None:
            answer: Frame | None = self._units.refuse(request, fault.code)
        else:
            answer = self._units.answer(request, self._peer, self._role)
        if answer is not None:
            self._statistics.refused += answer.pdu[0] >> 7
            delivery.send(pieces(fault, answer, self._framer))

    def _note_damage(self, *, overrun: bool) -> None:
        self._units.note_damage(overrun=overrun)

    def _end_request(self) -> None:
        """Another delimiter counts from the frame behind the answer on, both ways."""
        if isinstance(self._framer, AsciiFramer) and self._units.delimiter is not None:
            self._framer.delimiter = self._units.delimiter
