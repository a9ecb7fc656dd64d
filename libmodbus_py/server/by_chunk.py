"""
The sessions of Modbus/TCP connections: requests by the chunk, in C where it can be.

They say on the wire what `ByFrame` says, several times faster.
"""

from __future__ import annotations

import logging
import struct
from collections.abc import Callable

from ..protocol.errors import FrameError
from ..protocol.framing import Frame, TcpFramer
from ..protocol.pdu import MAX_PDU
from .faults.delivery import Delivery
from .faulty import FaultyAnswers
from .framed import FOUND_AT_ONCE
from .limits import ServerStatistics
from .service import Later
from .units import TcpUnits

__all__ = ["ByChunk", "Singles"]

logger: logging.Logger = logging.getLogger(__name__)

HEADER = struct.Struct(">HHHB")


class Singles:
    """
    The requests of connections that sent one each: together they are a chunk, too.

    Args:
        units: who answers.
        later: has a function called when all connections have been read.
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
        """Take a whole frame, which is answered this turn."""
        if not self._waiting:
            self._later(self._answer)
        self._waiting.append((session, request))

    def take_back(self, session: ByChunk) -> list[bytes]:
        """Give back what a session has just added, for more of it came: in records of TLS."""
        waiting, requests = self._waiting, []
        while waiting and waiting[-1][0] is session:
            requests.append(waiting.pop()[1])
        return requests[::-1]

    def _answer(self) -> None:
        waiting, self._waiting = self._waiting, []
        raised: BaseException | None = None
        chunk = b"".join([request for _, request in waiting])
        start = first = 0
        while first < len(waiting):
            count, start = self._answer_run(waiting, first, chunk, start)
            if count == 0:
                session, request = waiting[first]
                try:
                    session.take_one(request, 0)
                except BaseException as error:  # of a hook; the others want their answers
                    raised = raised or error
                start += len(request)
                count = 1
            first += count
        if raised is not None:
            raise raised

    def _answer_run(
        self, waiting: list[tuple[ByChunk, bytes]], first: int, chunk: bytes, start: int
    ) -> tuple[int, int]:
        """Answer those of one unit that follow each other, in C; give how many, and the rest."""
        unit = chunk[start + 6]
        device = self._units.without_faults(unit)
        if device is None or chunk[start + HEADER.size] not in device.in_c:
            return 0, start
        start, answers, count, refused = device.answer_chunk(chunk, start, unit)
        at = 0
        for session, _ in waiting[first : first + count]:
            end = at + 6 + (answers[at + 4] << 8 | answers[at + 5])
            session.write(answers[at:end])
            at = end
        self._statistics.requests += count
        self._statistics.refused += refused
        return count, start


class ByChunk:
    """
    Arguments as for `ByFrame`; there is nothing to wait for but its own turn, where requests are
    not answered in C, and answers that faults keep back.

    Args:
        singles: where requests go that come alone.

    Attributes:
        write: sends answers, after those that are kept back.
    """

    takes_requests = True

    # fmt: off
    __slots__ = (
        "_faulty", "_follow", "_hang_up", "_peer", "_pending", "_role", "_send", "_singles",
        "_statistics", "_units", "is_behind", "is_unfinished", "write",
    )
    # fmt: on

    def __init__(
        self,
        units: TcpUnits,
        peer: str,
        statistics: ServerStatistics,
        singles: Singles,
        write: Callable[[bytes], None],
        follow: Callable[[], None] = lambda: None,
        role: str | None = None,
        hang_up: Callable[[], bool] = lambda: False,
    ) -> None:
        self._units = units
        self._hang_up = hang_up
        self._send = write
        self._faulty: FaultyAnswers | None = None  # until something happens here
        self._peer = peer
        self._role = role
        self._statistics = statistics
        self._singles = singles
        self.write: Callable[[bytes], None] = write
        self._follow = follow
        self._pending = b""  # the beginning of a frame
        self.is_unfinished: bool = False
        self.is_behind: bool = False

    @property
    def is_waiting(self) -> bool:
        return self.is_behind or (self._faulty is not None and self._faulty.delivery.is_waiting)

    @property
    def is_owing(self) -> bool:
        return False

    def receive(self, data: bytes) -> int:
        if not self._pending and _is_one_frame(data):
            self._singles.add(self, data)
            return 1
        if before := self._singles.take_back(self):  # it must not be overtaken, and is counted
            return self.take(b"".join([*before, data])) - len(before)
        return self.take(data)

    def take(self, data: bytes) -> int:
        """As `receive`, without the help of others."""
        if self._pending:
            data = self._pending + data
        before = self._statistics.requests
        start, size, taken = 0, len(data), 0
        while size - start > HEADER.size:
            unit, function = data[start + 6], data[start + HEADER.size]
            device = self._units.without_faults(unit)
            if device is not None and function in device.in_c:
                end, answers, count, refused = device.answer_chunk(data, start, unit)
                if end > start:
                    self.write(answers)
                    self._count(count, refused)
                    start = end
                    continue
            if taken == FOUND_AT_ONCE:
                break
            end = self.take_one(data, start)
            if end == start:
                taken = 0
                break
            start = size if self._is_over else end
            taken += 1
        requests = self._statistics.requests - before
        self._pending = data[start:]
        self.is_behind = start < size and (taken == FOUND_AT_ONCE or self._is_lost(requests))
        self.is_unfinished = start < size and not self.is_behind
        if self.is_behind:
            self._follow()
        return requests

    def end(self) -> None:
        """What came is answered already."""

    def close(self) -> None:
        if self._faulty is not None:
            self._faulty.delivery.close()
            self._faulty = None  # which knows us: a circle would have to be looked for (gc)

    def _count(self, requests: int, refused: int) -> None:
        self._statistics.requests += requests
        self._statistics.refused += refused

    def take_one(self, data: bytes, start: int) -> int:
        """Deal with what C has left. Gives where it ends, or `start` if it is not complete."""
        transaction, protocol, length, unit = HEADER.unpack_from(data, start)
        end: int = start + 6 + length
        if not 2 <= length <= 1 + MAX_PDU or end > len(data):
            return start
        if protocol != 0:
            logger.debug("%s: header with protocol %d", self._peer, protocol)
            self._statistics.bad_frames += 1
            return end
        frame = Frame(unit, data[start + 7 : end], transaction)
        faults = self._units.faults
        if faults is not None and faults.concern(unit):
            self._statistics.requests += 1
            self._answers_with_faults().answer(frame)
            return end
        answer = self._units.answer(frame, self._peer, self._role)
        if answer is None:
            self._count(1, 0)
        else:
            pdu = answer.pdu
            self._count(1, pdu[0] >> 7)
            self.write(HEADER.pack(transaction, 0, 1 + len(pdu), unit) + pdu)
        return end

    @property
    def _is_over(self) -> bool:
        """Whether a fault has closed the connection: what is asked behind it is not executed."""
        return self._faulty is not None and self._faulty.delivery.is_over

    def _answers_with_faults(self) -> FaultyAnswers:
        if self._faulty is None:
            delivery = Delivery(self._send, self._follow_delivery, self._hang_up)
            self._faulty = FaultyAnswers(
                self._units, TcpFramer(), self._peer, self._role, self._statistics, delivery
            )
        return self._faulty

    def _follow_delivery(self) -> None:
        """What faults do not happen to waits behind what they keep back."""
        if self._faulty is not None:
            delivery = self._faulty.delivery
            self.write = delivery.send_bytes if delivery.is_waiting else self._send
        self._follow()

    def _is_lost(self, requests: int) -> bool:
        """A length that cannot be tells that nobody knows where the next frame begins."""
        rest = self._pending
        if len(rest) < 6 or 2 <= (length := rest[4] << 8 | rest[5]) <= 1 + MAX_PDU:
            return False
        if not requests:  # else they count first
            self._statistics.bad_frames += 1
            raise FrameError(f"header with length {length}, not 2..254", received=rest)
        return True


def _is_one_frame(data: bytes) -> bool:
    """Whether it is a whole frame of Modbus and nothing else."""
    size = len(data)
    return (
        8 <= size <= 7 + MAX_PDU
        and size == 6 + (data[4] << 8 | data[5])
        and not (data[2] or data[3])
    )
