"""
The sessions of Modbus/TCP connections: requests by the chunk, in C where possible.

Their answers are the same bytes as those of `ByFrame`, several times faster.
"""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter

from ..ports.trace import Trace
from ..protocol.errors import FrameError
from ..protocol.framing import FUNCTION, TRANSACTION, UNIT, Frame, cut, is_one_frame, mbap, split
from ..security.describing import CertificateHolder
from .by_frame import ByFrame
from .framed import FOUND_AT_ONCE
from .limits import ServerStatistics
from .service import Channel, Later, SessionState
from .units import TcpUnits

__all__ = ["ByChunk", "Singles"]

_request = itemgetter(1)


class Singles:
    """
    The single requests of several connections, answered together like one chunk.

    Args:
        units: the units that answer.
        later: calls a function when all connections have been read.
    """

    def __init__(
        self,
        units: TcpUnits,
        statistics: ServerStatistics,
        later: Later,
    ) -> None:
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
        waiting, requests = self._waiting, []
        while waiting and waiting[-1][0] is session:
            requests.append(waiting.pop()[1])
        return requests[::-1]

    def _answer(self) -> None:
        waiting, self._waiting = self._waiting, []
        raised: BaseException | None = None
        chunk = b"".join(map(_request, waiting))
        start = first = 0
        while first < len(waiting):
            count, start = self._answer_run(waiting, first, chunk, start)
            if count == 0:
                session, request = waiting[first]
                number = int.from_bytes(request[TRANSACTION], "big")
                try:
                    session.answer(Frame(request[UNIT], request[FUNCTION:], number))
                except (
                    BaseException
                ) as error:  # raised by a hook; the other requests are still answered
                    raised = raised or error
                start += len(request)
                count = 1
            first += count
        if raised is not None:
            raise raised

    def _answer_run(
        self, waiting: list[tuple[ByChunk, bytes]], first: int, chunk: bytes, start: int
    ) -> tuple[int, int]:
        """Answer the first requests, all of one unit, in C; return their number, and the rest."""
        unit = chunk[start + UNIT]
        device = self._units.in_c[unit]
        if device is None or chunk[start + FUNCTION] not in device.in_c:
            return 0, start
        start, answers, count, refused = device.answer_chunk(chunk, start, unit)
        if count == 1:
            waiting[first][0].write(answers)
        elif count:
            asking = waiting[first : first + count]
            for (session, _), answer in zip(asking, split(answers), strict=True):
                session.write(answer)
        self._statistics.requests += count
        self._statistics.refused += refused
        return count, start


class ByChunk:
    """
    A session of Modbus/TCP. Arguments as for `ByFrame`, whose framing is "tcp" here.

    Requests that C leaves are answered one by one, and where an interceptor or a trace needs to see
    each frame, by an inner session, whose channel this is.

    Args:
        singles: takes requests that come alone.
    """

    # fmt: off
    __slots__ = (
        "_by_frame", "_channel", "_is_behind", "_pending", "_singles", "_statistics", "_units",
        "address", "hang_up", "holder", "role", "state", "trace", "write",
    )
    # fmt: on

    def __init__(
        self, units: TcpUnits, channel: Channel, statistics: ServerStatistics, singles: Singles
    ) -> None:
        self._units = units
        self._statistics = statistics
        self._singles = singles
        # For interceptors, damage and traces; from when it is made, for all that C leaves.
        self._by_frame: ByFrame | None = None
        self._pending = b""  # the beginning of a frame, or bytes that were not searched yet
        self._is_behind = False
        self.state: SessionState = SessionState.READING
        self._channel = channel
        self.address: str = channel.address
        self.role: str | None = channel.role
        self.holder: CertificateHolder | None = channel.holder
        self.trace: Trace | None = channel.trace
        self.write: Callable[[bytes], None] = channel.write
        self.hang_up: Callable[[], bool] = channel.hang_up

    def receive(self, data: bytes) -> int:
        if not self._pending and is_one_frame(data) and self.trace is None:
            self._singles.add(self, data)
            return 1
        if before := self._singles.take_back(
            self
        ):  # the single request must not be overtaken, and is counted
            return self.take(b"".join([*before, data])) - len(before)
        return self.take(data)

    def take(self, data: bytes) -> int:
        """As `receive`, without the help of other sessions."""
        if self._pending:
            data = self._pending + data
        before = self._statistics.requests
        start, size, taken, is_lost = 0, len(data), 0, False
        try:
            while (start := self._answer_in_c(data, start)) < size and taken < FOUND_AT_ONCE:
                found: list[Frame | FrameError] = []
                end = cut(data, start, found, 1)
                if end == start:
                    taken = 0
                    break
                self.answer(found[0])
                start = size if self._is_over else end
                taken += 1
        except FrameError as error:
            is_lost = self._statistics.requests > before
            if not is_lost:  # else the requests before it count first
                self.answer(error)
                raise
        self._pending = data[start:]
        self._is_behind = start < size and (taken == FOUND_AT_ONCE or is_lost)
        self._set_state()
        if self._is_behind:
            self._channel.follow()
        return self._statistics.requests - before

    def answer(self, found: Frame | FrameError) -> None:
        """Answer a request without C, or note damage."""
        if (
            isinstance(found, FrameError)
            or self._by_frame is not None
            or self._units.interceptor is not None
            or self.trace is not None
        ):
            by_frame = self._rest()
            by_frame.tell_received([found])
            by_frame.take([found])
            return
        self._statistics.requests += 1
        if (answer := self._units.answer(found, self._channel)) is not None:
            self._statistics.refused += answer.pdu[0] >> 7
            self.write(mbap(answer.transaction, answer.unit, answer.pdu))

    def follow(self) -> None:
        """Note that an answer is delayed from now on, or no longer."""
        self._set_state()
        self._channel.follow()

    def end(self) -> None:
        if self.trace is not None:
            self._rest().tell_rest(self._pending)
        self._pending, self._is_behind = b"", False
        self._set_state()

    def close(self) -> None:
        self.end()
        if self._by_frame is not None:
            self._by_frame.close()
            self._by_frame = None  # it refers to the channel, and so to this session

    def _answer_in_c(self, data: bytes, start: int) -> int:
        """Answer the requests from `start` on, up to the first that C leaves; return its start."""
        while len(data) - start > FUNCTION and not self._is_held:
            unit = data[start + UNIT]
            device = self._units.in_c[unit]
            if device is None or data[start + FUNCTION] not in device.in_c:
                break
            end, answers, requests, refused = device.answer_chunk(data, start, unit)
            if end == start:
                break
            if (trace := self.trace) is not None:
                _tell(trace, data[start:end], answers)
            self.write(answers)
            self._statistics.requests += requests
            self._statistics.refused += refused
            start = end
        return start

    def _rest(self) -> ByFrame:
        if self._by_frame is None:
            # pyright takes a function in a slot for a method.
            channel: Channel = self  # pyright: ignore
            self._by_frame = ByFrame(self._units, "tcp", channel, self._statistics)
        return self._by_frame

    def _set_state(self) -> None:
        if self._is_behind:
            self.state = SessionState.BEHIND
        elif self._is_held:
            self.state = SessionState.HELD
        else:
            self.state = SessionState.UNFINISHED if self._pending else SessionState.READING

    @property
    def _is_held(self) -> bool:
        return self._by_frame is not None and self._by_frame.is_held

    @property
    def _is_over(self) -> bool:
        return self._by_frame is not None and self._by_frame.is_over


def _tell(trace: Trace, requests: bytes, answers: bytes) -> None:
    """Report the requests that C has answered to a trace, one by one."""
    for request, answer in zip(split(requests), split(answers), strict=True):
        trace.tell("received", request, request[UNIT], request[FUNCTION])
        trace.tell("sent", answer, answer[UNIT], answer[FUNCTION])
