"""
A session: what one connection or one port received, and the answers to it.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Protocol

from ..protocol.errors import FrameError
from ..protocol.framing import AsciiFramer, Frame, Framing, TcpFramer, make_framer
from .faults import Delivery, pieces
from .limits import ServerStatistics
from .units import SerialUnits, TcpUnits

__all__ = ["AT_ONCE", "ENDS", "FOUND_AT_ONCE", "ByFrame", "Link", "Session"]

logger: logging.Logger = logging.getLogger(__name__)


# What a hook raises to end the program; whatever else is an answer, or our mistake.
ENDS = (SystemExit, KeyboardInterrupt)

# What one connection of many may have done for it before others have their turn: eight of the
# requests that are most; what costs is not to search 64 bytes, but to answer what is found.
AT_ONCE = 64
FOUND_AT_ONCE = 4


class Link(Protocol):
    """
    The connection that a session belongs to.

    Attributes:
        address: who asks: "192.0.2.7:51234", or the serial port.
        role: what the certificate of the peer says of it, if anything.
    """

    address: str
    role: str | None

    def write(self, data: bytes) -> None:
        """Send answers, in the order of the calls."""

    def follow(self) -> None:
        """Look again whether the session is behind, or waiting."""


class Session(Protocol):
    @property
    def takes_requests(self) -> bool:
        """Whether what comes is requests, and no handshake."""
        ...

    @property
    def is_unfinished(self) -> bool:
        """Whether a frame has begun whose end nothing but its last byte can tell."""
        ...

    @property
    def is_behind(self) -> bool:
        """Whether something was received that is still to be looked at: by `receive(b"")`."""
        ...

    @property
    def is_waiting(self) -> bool:
        """Whether the next bytes can wait, for it is behind, or an answer is kept back."""
        ...

    def receive(self, data: bytes) -> int:
        """
        Take received bytes, write the answers, give how many requests there were.

        While it is behind none come; a call without bytes goes on where the last one stopped.

        Raises:
            FrameError: the stream must be closed; there were no requests this time.
        """
        ...

    def close(self) -> None: ...


class ByFrame:
    """
    Any framing, frame by frame.

    Args:
        units: who answers.
        framing: "tcp", "rtu", "ascii" or "udp".
        peer: who asks.
        statistics: where it is counted.
        write: takes the answers to the bytes of one `receive` at once.
        follow: called when `is_waiting` may have changed.
        role: what the certificate of the peer says of it, if anything.
        at_once: how many bytes are searched for frames in one `receive`; of what is found
            then `FOUND_AT_ONCE` is answered. None for all: nobody else waits.
    """

    takes_requests = True

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
        self._units = units
        self._framer = make_framer(framing, "server")
        self._peer = peer
        self._role = role
        self._statistics = statistics
        self._write = write
        self._follow = follow
        self._at_once = at_once
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | None = None
        self._unsearched = b""
        self._is_quiet = False  # after that
        self._is_heard = True  # whether the silence after the last bytes has been waited for
        self._found: list[Frame | FrameError] = []
        # Only with faults do answers leave at other times than they are found.
        self._delivery = Delivery(write, follow) if units.faults else None
        self._follow_delimiter()

    @property
    def is_unfinished(self) -> bool:
        # A line has noise on it, and silence ends what began.
        return self._framer.quiet is None and self._framer.pending > 0

    @property
    def is_behind(self) -> bool:
        is_lost = not self._framer.in_step
        return bool(self._found or self._unsearched or self._is_quiet or is_lost)

    @property
    def is_waiting(self) -> bool:
        return self.is_behind or (self._delivery is not None and self._delivery.is_waiting)

    def receive(self, data: bytes) -> int:
        if data:
            self._stop_timer()
            self._unsearched += data
            self._is_heard = False
            if self._at_once is not None and len(self._unsearched) > self._at_once:
                self._follow()
                return 0
        if not self._found and self._framer.in_step:
            self._search()
        most = len(self._found) if self._at_once is None else FOUND_AT_ONCE
        now, self._found = self._found[:most], self._found[most:]
        requests = self._answer(now)
        if not (self._found or self._framer.in_step):
            self._unsearched = b""
            if not requests:  # else they count first
                raise FrameError("stream out of step")
        if self.is_behind:
            self._follow()
        elif self._framer.quiet and self._framer.pending and not self._is_heard:
            self._is_heard = True
            self._timer = self._loop.call_later(self._framer.quiet, self._silence)
        return requests

    def close(self) -> None:
        self._stop_timer()
        if self._delivery is not None:
            self._delivery.close()

    def _search(self) -> None:
        if self._unsearched or not self._is_quiet:
            piece = self._unsearched[: self._at_once]
            self._unsearched = self._unsearched[len(piece) :]
            self._found = self._framer.scan(piece)
        else:
            self._is_quiet = False
            self._found = self._framer.scan_silence()

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _silence(self) -> None:
        """Whoever follows calls `receive` in its turn, and counts the requests."""
        self._timer = None
        self._is_quiet = True
        self._follow()

    def _answer(self, found: list[Frame | FrameError]) -> int:
        adus = bytearray()
        requests = 0
        try:
            for each in found:
                if isinstance(each, FrameError):
                    self._note_damage(each)
                else:
                    requests += 1
                    self._answer_one(each, adus)
        finally:  # a hook may end the program: what it did before is answered
            self._statistics.requests += requests
            if adus:
                self._write(bytes(adus))
        return requests

    def _note_damage(self, error: FrameError) -> None:
        logger.debug("%s: %s: %s", self._peer, error, error.received.hex(" "))
        self._statistics.bad_frames += 1
        self._units.note_damage(overrun=error.overrun)

    def _answer_one(self, request: Frame, adus: bytearray) -> None:
        if self._delivery is not None:
            self._answer_with_faults(request, self._delivery)
        elif (answer := self._units.answer(request, self._peer, self._role)) is not None:
            self._count_refusal(answer)
            adus += self._framer.encode(answer)
        self._follow_delimiter()

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
            self._count_refusal(answer)
            delivery.send(pieces(fault, answer, self._framer))

    def _count_refusal(self, answer: Frame) -> None:
        self._statistics.refused += answer.pdu[0] >> 7

    def _follow_delimiter(self) -> None:
        """From the frame behind the answer on, both ways."""
        if isinstance(self._framer, AsciiFramer) and self._units.delimiter is not None:
            self._framer.delimiter = self._units.delimiter
