"""
Sessions in which devices answer the requests of one connection or port, frame by frame.
"""

from __future__ import annotations

from ..protocol.errors import FrameError
from ..protocol.framing import AsciiFramer, Frame, Framing, Overheard
from .faults.delivery import Delivery
from .faults.faulty import FaultyAnswers
from .framed import Echoes, Framed
from .limits import ServerStatistics
from .service import Channel
from .units import SerialUnits, TcpUnits

__all__ = ["ByFrame"]


class ByFrame(Framed):
    """
    A session of any framing, which answers frame by frame.

    Args:
        units: the devices.
        framing, channel, statistics, at_once, is_datagram, pause, echoes: as for `Framed`.
    """

    def __init__(
        self,
        units: TcpUnits | SerialUnits,
        framing: Framing,
        channel: Channel,
        statistics: ServerStatistics,
        at_once: int | None = None,
        *,
        is_datagram: bool = False,
        pause: float = 0.0,
        echoes: Echoes | None = None,
    ) -> None:
        super().__init__(
            framing,
            channel,
            statistics,
            units.has,
            at_once,
            is_datagram=is_datagram,
            pause=pause,
            echoes=echoes,
        )
        self._units = units
        self._faulty: FaultyAnswers | None = None  # None until a fault may happen on this channel
        self._is_ascii = isinstance(self._framer, AsciiFramer)
        self._follow_delimiter()

    @property
    def is_held(self) -> bool:
        return self._faulty is not None and self._faulty.delivery.is_waiting

    @property
    def is_over(self) -> bool:
        """True once a fault has closed the connection: nothing is executed any more."""
        return self._faulty is not None and self._faulty.delivery.is_over

    def close(self) -> None:
        super().close()
        if self._faulty is not None:
            self._faulty.delivery.close()
            self._faulty = None  # it refers to the channel, and so to this session

    def note_damage(self, error: FrameError) -> None:
        super().note_damage(error)
        self._units.note_damage(overrun=error.overrun)

    def note_overheard(self, answer: Overheard) -> None:
        self._units.note_overheard()

    def _take_one(self, request: Frame) -> None:
        faults = self._units.faults
        # Once a fault has delayed an answer, all later answers go behind it.
        if self._faulty is not None or (faults is not None and faults.concern(request.unit)):
            if not self.is_over:
                self._faulty_answers().answer(request)
        elif (answer := self._answer(request)) is not None:
            self._reply(answer)
        if self._is_ascii:
            self._follow_delimiter()

    def _answer(self, request: Frame) -> Frame | None:
        return self._units.answer(request, self._channel)

    def _faulty_answers(self) -> FaultyAnswers:
        if self._faulty is None:
            delivery = Delivery(self._channel, self._trace, self._write)
            self._faulty = FaultyAnswers(
                self._units, self._framer, self._answer, self._statistics, delivery
            )
        return self._faulty

    def _follow_delimiter(self) -> None:
        """Use a changed delimiter from the frame after the answer on, in both directions."""
        if isinstance(self._framer, AsciiFramer) and self._units.delimiter is not None:
            self._framer.delimiter = self._units.delimiter
