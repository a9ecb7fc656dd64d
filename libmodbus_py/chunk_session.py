"""
The session of a Modbus/TCP connection: requests by the chunk, in C where it can be.

Says on the wire what `FramerSession` says, several times faster.
"""

from __future__ import annotations

import logging
import struct
from collections.abc import Callable

from .errors import FrameError
from .framing import Frame, TcpFramer
from .limits import Statistics
from .pdu import MAX_PDU
from .units import TcpUnits

__all__ = ["ChunkSession"]

logger = logging.getLogger(__name__)

HEADER = struct.Struct(">HHHB")

encode = TcpFramer().encode


class ChunkSession:
    """Arguments as for `FramerSession`; there is never anything to wait for."""

    is_waiting = False

    __slots__ = ("_peer", "_pending", "_statistics", "_units", "_write", "is_unfinished")

    def __init__(
        self,
        units: TcpUnits,
        peer: str,
        statistics: Statistics,
        write: Callable[[bytes], None],
    ) -> None:
        self._units = units
        self._peer = peer
        self._statistics = statistics
        self._write = write
        self._pending = b""  # the beginning of a frame
        self.is_unfinished = False

    def receive(self, data: bytes) -> int:
        if self._pending:
            data = self._pending + data
        before = self._statistics.requests
        start, size = 0, len(data)
        while size - start >= HEADER.size:
            unit = data[start + 6]
            device = self._units.device(unit)
            if device is not None and device.is_plain:
                end, answers, count, refused = device.answer_chunk(data, start, unit)
                if end > start:
                    self._write(answers)
                    self._count(count, refused)
                    start = end
                    continue
            end = self._take_one(data, start)
            if end == start:
                break
            start = end
        self._pending = data[start:]
        self.is_unfinished = start < size
        if self.is_unfinished:
            self._check_length()
        return self._statistics.requests - before

    def close(self) -> None:
        """Nothing goes on."""

    def _count(self, requests: int, refused: int) -> None:
        self._statistics.requests += requests
        self._statistics.refused += refused

    def _take_one(self, data: bytes, start: int) -> int:
        """Deal with what C has left. Gives where it ends, or `start` if it is not complete."""
        transaction, protocol, length, unit = HEADER.unpack_from(data, start)
        end: int = start + 6 + length
        if not 2 <= length <= 1 + MAX_PDU or end > len(data):
            return start
        if protocol != 0:
            logger.debug("%s: header with protocol %d", self._peer, protocol)
            self._statistics.bad_frames += 1
            return end
        answer = self._units.answer(Frame(unit, data[start + 7 : end], transaction), self._peer)
        self._count(1, 0 if answer is None else answer.pdu[0] >> 7)
        if answer is not None:
            self._write(encode(answer))
        return end

    def _check_length(self) -> None:
        """A length that cannot be tells that nobody knows where the next frame begins."""
        rest = self._pending
        if len(rest) >= 6 and not 2 <= (length := rest[4] << 8 | rest[5]) <= 1 + MAX_PDU:
            self._statistics.bad_frames += 1
            raise FrameError(f"header with length {length}, not 2..254", received=rest)
