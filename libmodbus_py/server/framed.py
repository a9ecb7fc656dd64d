"""
What the sessions have in common that go frame by frame: bytes in, frames out, in turns.
"""

from __future__ import annotations

import asyncio
import logging
from abc import ABC, abstractmethod
from collections.abc import Callable

from ..protocol.errors import FrameError
from ..protocol.framing import Frame, Framing, make_framer
from .limits import ServerStatistics

__all__ = ["AT_ONCE", "FOUND_AT_ONCE", "Framed"]

logger: logging.Logger = logging.getLogger(__name__)

# What one connection of many may have done for it before others have their turn: eight of the
# requests that are most; what costs is not to search 64 bytes, but to answer what is found.
AT_ONCE = 64
FOUND_AT_ONCE = 4


class Framed(ABC):
    """
    Finds the frames in what a link receives.

    Args:
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
        framing: Framing,
        peer: str,
        statistics: ServerStatistics,
        write: Callable[[bytes], None],
        follow: Callable[[], None] = lambda: None,
        role: str | None = None,
        at_once: int | None = None,
    ) -> None:
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
        return self.is_behind

    @property
    def is_owing(self) -> bool:
        return False

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
        requests = self._take(now)
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

    def end(self) -> None:  # noqa: B027  # what is answered at once is answered
        """Nothing more comes."""

    def close(self) -> None:
        self._stop_timer()

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

    def _take(self, found: list[Frame | FrameError]) -> int:
        """Deal with what was found; give how many requests that were."""
        adus = bytearray()
        requests = 0
        try:
            for each in found:
                if isinstance(each, FrameError):
                    logger.debug("%s: %s: %s", self._peer, each, each.received.hex(" "))
                    self._statistics.bad_frames += 1
                    self._note_damage(overrun=each.overrun)
                else:
                    requests += 1
                    self._take_one(each, adus)
        finally:  # a hook may end the program: what it did before is answered
            self._statistics.requests += requests
            if adus:
                self._write(bytes(adus))
        return requests

    def _take_one(self, request: Frame, adus: bytearray) -> None:
        if (answer := self._answer(request)) is not None:
            self._statistics.refused += answer.pdu[0] >> 7
            adus += self._framer.encode(answer)
        self._end_request()

    @abstractmethod
    def _answer(self, request: Frame) -> Frame | None:
        """Give the answer, if there is one now."""

    def _note_damage(self, *, overrun: bool) -> None:  # noqa: B027  # not everybody counts them
        """Bytes came that are no frame."""

    def _end_request(self) -> None:  # noqa: B027  # few requests change the line
        """A request was dealt with."""
