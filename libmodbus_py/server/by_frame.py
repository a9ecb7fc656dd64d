"""
Devices answer what one connection or one port received, frame by frame.
"""

from __future__ import annotations

from collections.abc import Callable

from ..protocol.errors import FrameError
from ..protocol.framing import AsciiFramer, Frame, Framing
from .faults.delivery import Delivery
from .faulty import FaultyAnswers
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
        hang_up: as of `Link`.
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
        hang_up: Callable[[], bool] = lambda: False,
    ) -> None:
        super().__init__(framing, peer, statistics, write, follow, role, at_once)
        self._units = units
        self._hang_up = hang_up
        # With faults answers leave at other times than they are found.
        self._faulty: FaultyAnswers | None = None
        self._end_request()

    @property
    def is_waiting(self) -> bool:
        return self.is_behind or (self._faulty is not None and self._faulty.delivery.is_waiting)

    def close(self) -> None:
        super().close()
        if self._faulty is not None:
            self._faulty.delivery.close()

    def _take(self, found: list[Frame | FrameError]) -> int:
        # Not in the middle of these, for what is answered at once is sent behind them all; and
        # for ever, as what faults keep back comes before what follows.
        if self._faulty is None and self._units.faults is not None:
            delivery = Delivery(self._write, self._follow, self._hang_up)
            self._faulty = FaultyAnswers(
                self._units, self._framer, self._peer, self._role, self._statistics, delivery
            )
        return super()._take(found)

    def _answer(self, request: Frame) -> Frame | None:
        if self._faulty is None:
            return self._units.answer(request, self._peer, self._role)
        self._faulty.answer(request)
        return None

    def _note_damage(self, *, overrun: bool) -> None:
        self._units.note_damage(overrun=overrun)

    def _end_request(self) -> None:
        """Another delimiter counts from the frame behind the answer on, both ways."""
        if isinstance(self._framer, AsciiFramer) and self._units.delimiter is not None:
            self._framer.delimiter = self._units.delimiter
