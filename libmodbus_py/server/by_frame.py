"""
Sessions in which devices answer the requests of one connection or port, frame by frame.
"""

from __future__ import annotations

from ..protocol.errors import FrameError
from ..protocol.framing import AsciiFramer, Frame, Framing, Overheard
from .framed import Echoes, Framed
from .limits import ServerStatistics
from .service import Channel, Interception, Interceptor
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
        self._interception: Interception | None = None  # None until a unit has one
        self._is_ascii = isinstance(self.framer, AsciiFramer)
        self._follow_delimiter()

    @property
    def is_held(self) -> bool:
        return self._interception is not None and self._interception.is_waiting

    @property
    def is_over(self) -> bool:
        """True once an interception has closed the connection: nothing is executed any more."""
        return self._interception is not None and self._interception.is_over

    @property
    def interceptor(self) -> Interceptor | None:
        return self._units.interceptor

    def close(self) -> None:
        super().close()
        if self._interception is not None:
            self._interception.close()
            self._interception = None  # it refers to this session

    def note_damage(self, error: FrameError) -> None:
        super().note_damage(error)
        self._units.note_damage(overrun=error.overrun)

    def note_overheard(self, answer: Overheard) -> None:
        self._units.note_overheard()

    def _take_one(self, request: Frame) -> None:
        interception, interceptor = self._interception, self._units.interceptor
        if interception is None and interceptor is not None and interceptor.concerns(request.unit):
            interception = self._interception = interceptor.intercept(self)
        if interception is not None:  # all later answers go behind one that it has delayed
            if not interception.is_over:
                interception.answer(request)
        elif (answer := self.answer(request)) is not None:
            self._reply(answer)
        if self._is_ascii:
            self._follow_delimiter()

    def answer(self, request: Frame) -> Frame | None:
        return self._units.answer(request, self.channel)

    def is_answered(self, request: Frame) -> bool:
        """See `Intercepted`."""
        return self._units.is_answered(request)

    def refuse(self, request: Frame, code: int) -> Frame:
        """See `Intercepted`."""
        return self._units.refuse(request, code)

    def _follow_delimiter(self) -> None:
        """Use a changed delimiter from the frame after the answer on, in both directions."""
        if isinstance(self.framer, AsciiFramer) and self._units.delimiter is not None:
            self.framer.delimiter = self._units.delimiter
