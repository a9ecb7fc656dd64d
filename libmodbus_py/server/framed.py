"""
The base of sessions that answer frame by frame: bytes in, frames out, in turns.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable

from ..protocol.errors import FrameError
from ..protocol.framing import Frame, Framing, Overheard, RtuFramer, make_framer
from ..protocol.logs import HarmlessLogger
from .limits import ServerStatistics
from .service import Channel, SessionState

__all__ = ["AT_ONCE", "FOUND_AT_ONCE", "Framed"]

logger: HarmlessLogger = HarmlessLogger(__name__)

# Limits for one of many connections before others have their turn: bytes that are searched, and
# requests that are answered. Searching 64 bytes is cheap; answering the requests in them is not.
AT_ONCE = 64
FOUND_AT_ONCE = 4


class Framed(ABC):
    """
    Finds the frames in what a channel receives, and writes the answers to it.

    Args:
        framing: "tcp", "rtu", "ascii" or "udp".
        channel: channel of the client.
        statistics: the counters of requests.
        is_ours: returns True if requests to a unit are answered here; others on the line may
            answer all other units.
        at_once: the number of bytes searched for frames in one `receive`; of these frames,
            `FOUND_AT_ONCE` are answered. None for no limit, where no other client waits.
        is_datagram: True if what is received at once is all there will be of its frames.
        pause: the seconds between two frames on a serial line, else 0.
    """

    def __init__(
        self,
        framing: Framing,
        channel: Channel,
        statistics: ServerStatistics,
        is_ours: Callable[[int], bool],
        at_once: int | None = None,
        *,
        is_datagram: bool = False,
        pause: float = 0.0,
    ) -> None:
        self._framer = make_framer(framing, "server", pause)
        if isinstance(self._framer, RtuFramer):
            self._framer.is_ours = is_ours
        self._is_datagram = is_datagram
        self._channel = channel
        self._trace = channel.trace
        self._statistics = statistics
        self._at_once = at_once
        self._timer: asyncio.TimerHandle | None = None
        self._unsearched = b""
        self._is_quiet = False  # True if silence followed the unsearched bytes
        self._held: tuple[Frame, bytes] | None = None  # the answer to the last request so far
        self._is_heard = True  # True once the silence after the latest bytes is awaited
        self._found: list[Frame | FrameError] = []
        self._owed: Collection[object] = ()  # requests whose answers are still to come
        self._has_ended = False

    @property
    def state(self) -> SessionState:
        if not self._has_ended:
            if self._is_behind:
                return SessionState.BEHIND
            if self.is_held:
                return SessionState.HELD
            # A line has noise, and silence ends a frame that has begun.
            if self._framer.quiet is None and self._framer.rest:
                return SessionState.UNFINISHED
        return SessionState.OWING if self._owed else SessionState.READING

    @property
    def _is_behind(self) -> bool:
        is_lost = not self._framer.in_step
        return bool(self._found or self._unsearched or self._is_quiet or is_lost)

    @property
    def is_held(self) -> bool:
        """True while an answer is delayed, and with it all that follow."""
        return False

    def receive(self, data: bytes) -> int:
        if data:
            if self._timer is not None:
                self._timer.cancel()
            self._unsearched += data
            self._is_heard = False
            if self._at_once is not None and len(self._unsearched) > self._at_once:
                self._channel.follow()
                return 0
        if not self._found and self._framer.in_step:
            self._search()
        most = len(self._found) if self._at_once is None else FOUND_AT_ONCE
        now, self._found = self._found[:most], self._found[most:]
        requests = self.take(now)
        if self._held is not None and not (self._found or self._unsearched):
            self._send(*self._held)
            self._held = None
        if not (self._found or self._framer.in_step):
            self._unsearched = b""
            if not requests:  # else the silence counts first
                raise FrameError("stream out of step")
        if self._is_behind:
            self._channel.follow()
        elif self._framer.quiet and self._framer.pending and not self._is_heard:
            self._is_heard = True
            loop = asyncio.get_running_loop()
            self._timer = loop.call_later(self._framer.quiet, self._note_silence)
        return requests

    def take(self, found: Iterable[Frame | FrameError]) -> int:
        """Answer the frames that were found, and return the number of requests."""
        requests = 0
        for each in found:
            if isinstance(each, FrameError):
                self.note_damage(each)
                continue
            self._held = None  # its client has given up waiting for it
            if isinstance(each, Overheard):
                self.note_overheard(each)
            else:
                requests += 1
                self._statistics.requests += 1  # before the client can see an answer
                self._take_one(each)
        return requests

    def end(self) -> None:
        if self._has_ended:
            return
        self._has_ended = True
        if self._timer is not None:
            self._timer.cancel()
        self.tell_rest(self._unsearched)
        self._unsearched, self._found = b"", []

    def close(self) -> None:
        self.end()

    def note_damage(self, error: FrameError) -> None:
        """Count bytes that are not a frame."""
        address = self._channel.address
        logger.debug("%s: %s: %s", address, error, error.received.hex(" "))
        self._statistics.bad_frames += 1

    def note_overheard(self, answer: Overheard) -> None:  # noqa: B027  # gateways count no units
        """Note what another unit on the line answers."""

    def _search(self) -> None:
        if self._unsearched or not self._is_quiet:
            piece = self._unsearched[: self._at_once]
            self._unsearched = self._unsearched[len(piece) :]
            self._found = self._framer.scan(piece)
            if self._is_datagram:
                self._found += self._framer.scan_silence()
                self._end_datagram()
        else:
            self._is_quiet = False
            self._found = self._framer.scan_silence()
        if self._trace is not None:
            self.tell_received(self._found)

    def _end_datagram(self) -> None:
        """Note what could begin a longer frame: its rest does not come in another datagram."""
        rest = self._framer.end()
        is_damaged = bool(self._found) and isinstance(self._found[-1], FrameError)
        if rest and not is_damaged:  # else it belongs to that damage
            self._found.append(FrameError("an unfinished frame", received=rest))

    def tell_received(self, found: Iterable[Frame | FrameError]) -> None:
        """Report the frames and damage that were found to the trace."""
        if self._trace is not None:
            for each in found:
                if isinstance(each, FrameError):
                    self._trace.tell("received", each.received)
                else:
                    adu = self._framer.encode(each)
                    self._trace.tell("received", adu, each.unit, each.pdu[0])

    def tell_rest(self, unsearched: bytes) -> None:
        """Report received bytes that are not answered any more to the trace."""
        if self._trace is not None:
            if self._framer.in_step:
                self.tell_received(self._framer.scan(unsearched))
            if rest := self._framer.end():
                self._trace.tell("received", rest)

    def _note_silence(self) -> None:
        """Make the channel call `receive` in its turn, so that the requests are counted."""
        self._timer = None
        self._is_quiet = True
        self._channel.follow()

    def _take_one(self, request: Frame) -> None:
        if (answer := self._answer(request)) is not None:
            self._reply(answer)

    def _reply(self, answer: Frame) -> None:
        """
        Send an answer; without transaction ids, only if no other request waits behind this one.

        Its client would take it for the answer to that one.
        """
        adu = self._framer.encode(answer)
        if self._framer.has_broadcast:
            self._held = answer, adu
        else:
            self._send(answer, adu)

    def _send(self, answer: Frame, adu: bytes) -> None:
        self._statistics.refused += answer.pdu[0] >> 7
        if self._trace is not None:
            self._trace.tell("sent", adu, answer.unit, answer.pdu[0])
        self._channel.write(adu)

    @abstractmethod
    def _answer(self, request: Frame) -> Frame | None:
        """Return the answer, or None if there is none yet."""
