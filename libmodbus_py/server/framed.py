"""The base of sessions that answer frame by frame: bytes in, frames out, in turns."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable

from ..ports.endpoint import Endpoint
from ..ports.trace import Trace
from ..protocol.echo import Echo
from ..protocol.errors import FrameError
from ..protocol.framing import (
    Frame,
    Framer,
    Framing,
    OverheardResponse,
    RtuFramer,
    make_framer,
    pdu_of,
)
from ..protocol.logs import HarmlessLogger
from ..protocol.rtu import may_be
from .limits import ServerStatistics
from .service import Channel, SessionState

logger: HarmlessLogger = HarmlessLogger(__name__)

FRAMES_AT_ONCE = 4
"""Requests of one of many connections that Python answers before others have their turn."""

ECHO_DELAY = 0.05
"""Seconds after which an echo is here: USB adapters keep bytes for 16 ms, busy machines longer."""


class SessionSettings:
    """Settings of the sessions of an endpoint; `has_turns` if others wait while one is answered."""

    def __init__(
        self, endpoint: Endpoint, statistics: ServerStatistics, *, has_turns: bool = False
    ) -> None:
        self.endpoint = endpoint
        self.statistics: ServerStatistics = statistics
        self.has_turns = has_turns
        self.framing: Framing = endpoint.framing
        self._was_echo_logged = False

    def new_echo(self) -> Echo | None:
        """Return the echo of a new connection, or None if there cannot be one."""
        setting = self.endpoint.options.get("echo")
        # A frame with a transaction id cannot be an echo, and a datagram has no connection.
        if self.endpoint.has_transactions or self.endpoint.is_datagram or setting is False:
            return None
        return Echo(setting)

    def note_echo(self) -> None:
        """Count a connection with an echo; log the first one."""
        self.statistics.echoes += 1
        if not self._was_echo_logged:
            self._was_echo_logged = True
            text = "%s: what is sent comes back (local echo), and is dropped; set echo=1 in the URL"
            logger.warning(text, self.endpoint)


class FrameServer(ABC):
    """
    Finds the frames for units that are ours in what a channel receives, and writes the answers.
    """

    def __init__(
        self, settings: SessionSettings, channel: Channel, is_ours: Callable[[int], bool]
    ) -> None:
        self._settings = settings
        self._echo = settings.new_echo()
        self.framer: Framer = make_framer(settings.framing, "server", settings.endpoint.pause)
        if isinstance(self.framer, RtuFramer):
            self.framer.is_ours = is_ours
        self.channel: Channel = channel
        self.trace: Trace | None = channel.trace
        self.statistics: ServerStatistics = settings.statistics
        self._timer: asyncio.TimerHandle | None = None
        self._unsearched = b""
        self._is_quiet = False  # True if silence followed the unsearched bytes
        # The answer to the last request so far.
        self._pending_answer: tuple[Frame, bytes] | None = None
        self._is_silence_awaited = True  # True once the silence after the latest bytes is awaited
        self._frames: list[Frame | FrameError] = []
        # The answer before, on a serial line, if its echo would be a request.
        self._last_answer = b""
        self._returns_until = 0.0  # the time (loop.time) until which its echo can come
        self._heard_at = 0.0  # the time of the latest bytes behind it
        self._suspect: Frame | None = None  # a request that may be this echo
        # Ends the wait for the echo of one byte.
        self._echo_timer: asyncio.TimerHandle | None = None
        self._is_echo_ruled_out = False  # True once an answer had no echo
        # A request of which one byte of the answer was sent.
        self._open_request: Frame | None = None
        self._unanswered: Collection[object] = ()  # requests that are not answered yet
        self._has_ended = False

    @property
    def state(self) -> SessionState:
        if not self._has_ended:
            if self._is_behind:
                return SessionState.BEHIND
            if self.is_held:
                return SessionState.HELD
            # A line has noise, and silence ends a frame that has begun.
            if self.framer.quiet is None and self.framer.rest:
                return SessionState.UNFINISHED
        return SessionState.OWING if self._unanswered else SessionState.READING

    @property
    def _is_behind(self) -> bool:
        is_lost = not self.framer.in_step
        return bool(self._frames or self._unsearched or self._is_quiet or is_lost)

    @property
    def is_held(self) -> bool:
        """True while an answer is delayed, and with it all that follow."""
        return False

    def receive(self, data: bytes) -> int:
        if data:
            if self._timer is not None:
                self._timer.cancel()
            if self._last_answer:
                self._heard_at = asyncio.get_running_loop().time()
            self._unsearched += data if self._echo is None else self._without_echo(self._echo, data)
            self._is_silence_awaited = False
        if self._suspect is not None and not self._is_echo_heard(data):
            return 0
        if not self._frames and self.framer.in_step:
            self._search()
        most = FRAMES_AT_ONCE if self._settings.has_turns else len(self._frames)
        now, self._frames = self._frames[:most], self._frames[most:]
        requests = self.take(now)
        if self._pending_answer is not None and not (self._frames or self._unsearched):
            self._send(*self._pending_answer)
            self._pending_answer = None
        if not (self._frames or self.framer.in_step):
            self._unsearched = b""
            if not requests:  # else the silence is counted first
                raise FrameError("stream out of step")
        is_unfinished = self.framer.pending or (self._echo is not None and self._echo.is_holding)
        if self._is_behind:
            self.channel.follow()
        elif self.framer.quiet and is_unfinished and not self._is_silence_awaited:
            self._is_silence_awaited = True
            loop = asyncio.get_running_loop()
            self._timer = loop.call_later(self.framer.quiet, self._note_silence)
        return requests

    def take(self, frames: list[Frame | FrameError]) -> int:
        """Answer the frames that were found, and return the number of requests."""
        requests = 0
        for at, frame in enumerate(frames):
            if isinstance(frame, FrameError):
                self.note_damage(frame)
                continue
            self._pending_answer = None  # the client no longer waits for this answer
            if self._may_be_echo(frame):
                self._frames = [*frames[at + 1 :], *self._frames]
                self._suspect = frame
                # One byte of the answer: it comes back alone only if there is an echo.
                self.channel.write(self._last_answer[:1])
                break
            self._last_answer = b""
            if frame is not self._open_request:
                self._open_request = None
            if isinstance(frame, OverheardResponse):
                self.note_overheard(frame)
            else:
                requests += 1
                self.statistics.requests += 1  # before the client can see an answer
                self._take_one(frame)
        return requests

    def end(self) -> None:
        if self._has_ended:
            return
        self._has_ended = True
        for timer in (self._timer, self._echo_timer):
            if timer is not None:
                timer.cancel()
        self._release_echo()
        if self.trace is not None:  # what was received is not answered any more
            if self.framer.in_step:
                self.tell_received(self.framer.scan(self._unsearched))
            if rest := self.framer.end():
                self.trace.tell("received", rest)
        self._unsearched, self._frames = b"", []

    def close(self) -> None:
        self.end()

    def note_damage(self, error: FrameError) -> None:
        address = self.channel.address
        logger.debug("%s: %s: %s", address, error, error.received.hex(" "))
        self.statistics.bad_frames += 1

    def note_overheard(self, answer: OverheardResponse) -> None:  # noqa: B027  # gateways count no units
        """Note a frame of another unit on the line."""

    def _search(self) -> None:
        if self._unsearched or not self._is_quiet:
            data, self._unsearched = self._unsearched, b""
            self._frames = self.framer.scan(data)
            if self._settings.endpoint.is_datagram:
                self._frames += self.framer.scan_silence()
                rest = self.framer.end()  # which does not go on in another datagram
                is_damaged = bool(self._frames) and isinstance(self._frames[-1], FrameError)
                if rest and not is_damaged:  # otherwise the bytes belong to that damage
                    self._frames.append(FrameError("an unfinished frame", received=rest))
        else:
            self._is_quiet = False
            self._frames = self.framer.scan_silence()
        self.tell_received(self._frames)

    def tell_received(self, frames: Iterable[Frame | FrameError]) -> None:
        if self.trace is not None:
            for frame in frames:
                if isinstance(frame, FrameError):
                    self.trace.tell("received", frame.received)
                else:
                    adu = self.framer.encode(frame)
                    self.trace.tell("received", adu, frame.unit, frame.pdu[0])

    def _note_silence(self) -> None:
        """Make the channel call `receive` in its turn, so that the requests are counted."""
        self._timer = None
        self._release_echo()
        self._is_quiet = True
        self.channel.follow()

    # --- local echo ---------------------------------------------------------------------------

    def sent(self, data: bytes, gone_at: float = 0.0) -> None:
        """
        Note that bytes of answers leave now, which may come back.

        Args:
            gone_at: on a serial line, when the last of them has left (loop.time).
        """
        self.framer.note_answer()
        if (echo := self._echo) is None:
            return
        if self._suspect is not None and len(data) == 1:
            loop = asyncio.get_running_loop()
            self._echo_timer = loop.call_at(gone_at + ECHO_DELAY, self._note_no_echo)
            return
        is_telling = echo.is_there is None and not _may_ask(self._settings.framing, data)
        if echo.is_there is None and not is_telling and self._settings.endpoint.is_serial:
            self._last_answer, self._returns_until = data, gone_at + ECHO_DELAY
        echo.sent(data, is_telling=is_telling)

    def _may_be_echo(self, frame: Frame) -> bool:
        """Return True for a request that came where an echo of the answer before would have."""
        if not self._last_answer or self._is_echo_ruled_out:
            return False
        is_late = self._heard_at > self._returns_until
        return not is_late and self.framer.encode(frame) == self._last_answer

    def _is_echo_heard(self, data: bytes) -> bool:
        """Return True if that byte came back, so that the doubted request was an echo, too."""
        if self._echo is None or self._echo_timer is None or self._last_answer[:1] not in data:
            return False
        self._echo_timer.cancel()
        self._unsearched = self._unsearched.replace(self._last_answer[:1], b"", 1)
        self._suspect = self._echo_timer = None
        self._echo.confirm()
        self._settings.note_echo()
        return True

    def _note_no_echo(self) -> None:
        """Answer the doubted request: it came again from its client, at once."""
        assert self._suspect is not None
        self._echo_timer, self._is_echo_ruled_out = None, True
        self._open_request, self._suspect = self._suspect, None
        self._frames.insert(0, self._open_request)
        self.channel.follow()

    def _without_echo(self, echo: Echo, data: bytes) -> bytes:
        was_there = echo.is_there
        data = echo.without(data)
        if echo.is_there is not was_there:
            if echo.is_there:
                self._settings.note_echo()
            else:
                self._echo = None
        return data

    def _release_echo(self) -> None:
        """Take what was held back for the beginning of an echo, because nothing follows."""
        if self._echo is not None:
            self._unsearched += self._echo.release()

    def write(self, data: bytes) -> None:
        if self._open_request is not None:
            self._open_request, data = None, data[1:]
        self.channel.write(data)
        # A serial port sends it after silence, and then calls `sent`.
        if not self._settings.endpoint.is_serial:
            self.sent(data)

    # --- answers ------------------------------------------------------------------------------

    def _take_one(self, request: Frame) -> None:
        if (answer := self.answer(request)) is not None:
            self._reply(answer)

    def _reply(self, answer: Frame) -> None:
        """
        Send an answer; without transaction ids, only if no other request waits that would take it.
        """
        adu = self.framer.encode(answer)
        if self.framer.has_broadcast:
            self._pending_answer = answer, adu
        else:
            self._send(answer, adu)

    def _send(self, answer: Frame, adu: bytes) -> None:
        self.statistics.refused += answer.pdu[0] >> 7
        if self.trace is not None:
            self.trace.tell("sent", adu, answer.unit, answer.pdu[0])
        self.write(adu)

    @abstractmethod
    def answer(self, request: Frame) -> Frame | None:
        """Return the answer, or None if there is none yet."""


def _may_ask(framing: Framing, adu: bytes) -> bool:
    """Return True if bytes that are sent may be a request when they come back; by length."""
    try:
        pdu = pdu_of(framing, adu)
    except ValueError:  # a part of a frame, or garbage of a fault
        return True
    return not pdu or may_be(pdu)[0]
