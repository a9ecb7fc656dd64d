"""
The sessions of devices: requests of one connection, datagram or port, frame by frame or in C.

Modbus/TCP is answered by the chunk, in C where possible: the same bytes as those of `ByFrame`,
several times faster. Requests that come alone are answered together with those of other
connections. Answers that have faults wait in a queue, and all that follow behind them.
"""

from __future__ import annotations

import asyncio
from collections import deque
from operator import itemgetter

from ..ports.trace import Trace
from ..protocol.errors import FrameError
from ..protocol.frames import (
    FUNCTION,
    UNIT,
    Frame,
    Framer,
    OverheardResponse,
    cut,
    is_one_frame,
    mbap,
    split,
)
from ..protocol.framing import AsciiFramer, TcpFramer
from .faults import Faults, Fragment, ServerFault
from .framed import FRAMES_AT_ONCE, FrameServer, SessionSettings
from .limits import ServerStatistics
from .service import Channel, Later, SessionState
from .units import SerialUnits, TcpUnits

MAX_WAITING_BYTES = 1 << 17
"""On a connection, fewer bytes wait: the answers to one read. On a serial line this limits the
answers to a client that does not wait for them."""

_request = itemgetter(1)


class ByFrame(FrameServer):
    """A session of any framing, which answers frame by frame."""

    def __init__(
        self, settings: SessionSettings, units: TcpUnits | SerialUnits, channel: Channel
    ) -> None:
        super().__init__(settings, channel, units.has)
        self._units = units
        self._faulty: FaultyAnswers | None = None  # None until a unit has faults
        self._is_ascii = isinstance(self.framer, AsciiFramer)
        self._follow_delimiter()

    @property
    def is_held(self) -> bool:
        return self._faulty is not None and self._faulty.is_waiting

    @property
    def is_over(self) -> bool:
        """True once a fault has closed the connection: nothing is executed any more."""
        return self._faulty is not None and self._faulty.is_over

    @property
    def faults(self) -> Faults | None:
        return self._units.faults

    def close(self) -> None:
        super().close()
        if self._faulty is not None:
            self._faulty.close()
            self._faulty = None  # it refers to this session

    def note_damage(self, error: FrameError) -> None:
        super().note_damage(error)
        self._units.note_damage(overrun=error.overrun)

    def note_overheard(self, answer: OverheardResponse) -> None:
        self._units.note_overheard()

    def _take_one(self, request: Frame) -> None:
        faulty, faults = self._faulty, self._units.faults
        if faulty is None and faults is not None and faults.concerns(request.unit):
            faulty = self._faulty = FaultyAnswers(self)
        if faulty is not None:  # all later answers go behind one that it has delayed
            if not faulty.is_over:
                faulty.answer(request)
        elif (answer := self.answer(request)) is not None:
            self._reply(answer)
        if self._is_ascii:
            self._follow_delimiter()

    def answer(self, request: Frame, code: int = 0) -> Frame | None:
        return self._units.answer(request, self.channel, code)

    def is_answered(self, request: Frame) -> bool:
        return self._units.is_answered(request)

    def _follow_delimiter(self) -> None:
        """Use a changed delimiter from the frame after the answer on, in both directions."""
        if isinstance(self.framer, AsciiFramer) and self._units.delimiter is not None:
            self.framer.delimiter = self._units.delimiter


def _sent(fault: ServerFault | None, answer: Frame, framer: Framer) -> list[Fragment]:
    if fault is not None:
        return fault.fragments(answer, framer)
    adu = framer.encode(answer)
    return [Fragment(0, adu, traced=((adu, answer),))]


class FaultyAnswers:
    """
    The answers of one session: in order, late, wrong, in fragments or not at all.

    Attributes:
        is_waiting: True while answers are to be sent later; nothing is received meanwhile.
        is_over: True once a fault has closed the connection; nothing is executed any more.
    """

    def __init__(self, session: ByFrame) -> None:
        self.is_waiting: bool = False
        self.is_over: bool = False
        self._session = session
        self._queue: deque[Fragment] = deque()
        self._queued = 0  # bytes
        self._timer: asyncio.TimerHandle | None = None

    def answer(self, request: Frame) -> None:
        """Execute a request, and deliver its answer as the fault that is due makes it."""
        session = self._session
        fault: ServerFault | None = None
        faults = session.faults
        if faults is not None and session.is_answered(request):
            has_transaction = isinstance(session.framer, TcpFramer)
            fault = faults.due(request, has_transaction=has_transaction)
        answer = session.answer(request, 0 if fault is None else fault.code or 0)
        if answer is not None:
            session.statistics.refused += answer.pdu[0] >> 7
            self.send(_sent(fault, answer, session.framer))

    def send(self, answer: list[Fragment]) -> None:
        """Send an answer after the previous ones; it is dropped if too much waits already."""
        if self._queued >= MAX_WAITING_BYTES or self.is_over:
            return
        self._queue += answer
        self._queued += sum(len(fragment.data) for fragment in answer)
        if self._timer is None:
            self._go_on()

    def close(self) -> None:
        """Drop all fragments that were not sent."""
        self._queue.clear()
        self._queued = 0
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _go_on(self) -> None:
        """Send the fragments that are due, then wait for the next."""
        while self._queue:
            if self._queue[0].wait:
                loop = asyncio.get_running_loop()
                self._timer = loop.call_later(self._queue[0].wait, self._send_next)
                break
            self._send_first()
        if self.is_waiting != bool(self._queue):
            self.is_waiting = not self.is_waiting
            self._session.channel.follow()

    def _send_next(self) -> None:
        self._timer = None
        self._send_first()
        self._go_on()

    def _send_first(self) -> None:
        fragment, session = self._queue.popleft(), self._session
        self._queued -= len(fragment.data)
        if session.trace is not None:
            for adu, frame in fragment.traced:
                facts = () if frame is None else (frame.unit, frame.pdu[0])
                session.trace.tell("sent", adu, *facts)
        if fragment.data or not fragment.is_last:
            session.write(fragment.data)
        if fragment.is_last and session.channel.hang_up():
            self.is_over = True
            self.close()


class ByChunk(ByFrame):
    """A session of Modbus/TCP: C answers what it can, and the rest is answered one by one."""

    def __init__(
        self, settings: SessionSettings, units: TcpUnits, channel: Channel, singles: Singles
    ) -> None:
        super().__init__(settings, units, channel)
        self._tcp_units = units
        self._singles = singles
        self._pending = b""  # the beginning of a frame, or bytes that were not searched yet
        self._has_more = False  # True if requests in these bytes wait for the next turn

    @property
    def state(self) -> SessionState:
        if self._has_more:
            return SessionState.BEHIND
        if self._faulty is not None and self._faulty.is_waiting:
            return SessionState.HELD
        return SessionState.UNFINISHED if self._pending else SessionState.READING

    def receive(self, data: bytes) -> int:
        if not self._pending and is_one_frame(data) and self.trace is None:
            self._singles.add(self, data)
            return 1
        if before := self._singles.take_back(self):  # which must not be overtaken, and is counted
            return self.take_chunk(b"".join([*before, data])) - len(before)
        return self.take_chunk(data)

    def take_chunk(self, data: bytes) -> int:
        """Answer requests as `receive` does, but never together with those of other sessions."""
        data = self._pending + data
        before = self.statistics.requests
        start, size, count, is_lost = 0, len(data), 0, False
        try:
            while (start := self._answer_in_c(data, start)) < size and count < FRAMES_AT_ONCE:
                frames: list[Frame | FrameError] = []
                end = cut(data, start, frames, 1)
                if end == start:
                    count = 0
                    break
                self.take_one(frames[0])
                start = size if self.is_over else end
                count += 1
        except FrameError as error:
            is_lost = self.statistics.requests > before
            if not is_lost:  # otherwise the requests before it are counted first
                self.take_one(error)
                raise
        self._pending = data[start:]
        self._has_more = start < size and (count == FRAMES_AT_ONCE or is_lost)
        if self._has_more:
            self.channel.follow()
        return self.statistics.requests - before

    def take_one(self, frame: Frame | FrameError) -> None:
        """Answer a request without C, or note damage."""
        if (
            isinstance(frame, FrameError)
            or self._tcp_units.faults is not None
            or self._faulty is not None
            or self.trace is not None
        ):
            self.tell_received([frame])
            self.take([frame])
            return
        self.statistics.requests += 1
        if (answer := self._tcp_units.answer(frame, self.channel)) is not None:
            self.statistics.refused += answer.pdu[0] >> 7
            self.channel.write(mbap(answer.transaction, answer.unit, answer.pdu))

    def end(self) -> None:
        self._unsearched, self._pending, self._has_more = self._pending, b"", False
        super().end()

    def _answer_in_c(self, data: bytes, start: int) -> int:
        """Answer the requests from `start` on, up to the first that C leaves; return its start."""
        while len(data) - start > FUNCTION and not self.is_held:
            unit = data[start + UNIT]
            device = self._tcp_units.in_c[unit]
            if device is None or data[start + FUNCTION] not in device.in_c:
                break
            end, answers, requests, refusals = device.answer_chunk(data, start, unit)
            if end == start:
                break
            if (trace := self.trace) is not None:
                _tell(trace, data[start:end], answers)
            self.channel.write(answers)
            self.statistics.requests += requests
            self.statistics.refused += refusals
            start = end
        return start


class Singles:
    """The single requests of several connections, answered together like one chunk."""

    def __init__(self, units: TcpUnits, statistics: ServerStatistics, later: Later) -> None:
        self._units = units
        self._statistics = statistics
        self._later = later
        self._waiting: list[tuple[ByChunk, bytes]] = []

    def add(self, session: ByChunk, request: bytes) -> None:
        """Add a whole frame, which is answered in this turn."""
        if not self._waiting:
            self._later(self._answer)
        self._waiting.append((session, request))

    def take_back(self, session: ByChunk) -> list[bytes]:
        """Return what a session has just added, because it received more, in records of TLS."""
        queue, requests = self._waiting, []
        while queue and queue[-1][0] is session:
            requests.append(queue.pop()[1])
        return requests[::-1]

    def _answer(self) -> None:
        """Answer runs of requests to one unit in C, and those that C leaves one by one."""
        queue, self._waiting = self._waiting, []
        failure: BaseException | None = None
        chunk = b"".join(map(_request, queue))
        start = first = 0
        while first < len(queue):
            unit, count = chunk[start + UNIT], 0
            device = self._units.in_c[unit]
            if device is not None and chunk[start + FUNCTION] in device.in_c:
                start, answers, count, refusals = device.answer_chunk(chunk, start, unit)
                self._statistics.requests += count
                self._statistics.refused += refusals
                if count == 1:
                    queue[first][0].channel.write(answers)
                elif count:
                    part = queue[first : first + count]
                    for (session, _), answer in zip(part, split(answers), strict=True):
                        session.channel.write(answer)
            if count == 0:
                session, request = queue[first]
                number = int.from_bytes(request[:2], "big")
                try:
                    session.take_one(Frame(unit, request[FUNCTION:], number))
                except BaseException as error:  # of a hook; the others are still answered
                    failure = failure or error
                start += len(request)
                count = 1
            first += count
        if failure is not None:
            raise failure


def _tell(trace: Trace, requests: bytes, answers: bytes) -> None:
    for request, answer in zip(split(requests), split(answers), strict=True):
        trace.tell("received", request, request[UNIT], request[FUNCTION])
        trace.tell("sent", answer, answer[UNIT], answer[FUNCTION])
