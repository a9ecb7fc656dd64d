"""
Frames heard on a line, of which it is not known whether they are requests or responses.

Bytes only; no clock. `RtuEitherWay` finds frames by both length rules of `pdu` and the CRC;
`may_be` asks the same rules about a frame that is already cut out, as in ASCII.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from .framing import Frame, scanner
from .pauses import ALLOWANCE
from .pdu import request_length, response_length
from .scan import AT_END, GOES_ON, MAX_PDU, SILENT, FrameScanner, crc16

__all__ = ["EitherWay", "NoFrame", "RtuEitherWay", "may_be"]


class EitherWay(NamedTuple):
    """A frame whose CRC fits, by one length rule or by both; `start` and `end` in the stream."""

    start: int
    end: int
    frame: Frame
    may_ask: bool
    may_answer: bool


class NoFrame(NamedTuple):
    """Bytes that are none."""

    start: int
    end: int
    data: bytes


def may_be(pdu: bytes) -> tuple[bool, bool]:
    """Return two bools by length: the PDU can be a request, and it can be a response."""
    size = len(pdu)
    may_ask = pdu[0] < 0x80 and request_length(pdu) in (size, 0)
    return may_ask, response_length(pdu) in (size, 0)


class RtuEitherWay:
    """
    Finds RTU frames in a stream where requests and responses follow one another.

    Both scans look at the same bytes. Where only one of them finds a frame, and the other may
    still find a longer one, it is decisive what is more likely there: see `take`.

    Args:
        pause: as for `RtuFramer`.

    Attributes:
        quiet: seconds without a byte after which `silence` should be called.
        offset: the position in the stream of the first byte that is still searched.
    """

    def __init__(self, pause: float = 0.0) -> None:
        self.quiet: float = pause + ALLOWANCE
        self._asking, self._answering = scanner("server"), scanner("client")
        self._buffer = bytearray()
        self._fresh = [0]  # where frames should begin: behind silence and good frames
        self._is_quiet = self._is_over = False
        self.offset: int = 0

    def feed(self, data: bytes) -> None:
        """Take received bytes."""
        self._buffer += data
        self._is_quiet = self._is_over = False

    def silence(self, *, is_long: bool = False) -> None:
        """
        Note that the line is quiet; afterwards `take` may return more.

        Args:
            is_long: True if the silence is so long that no frame will be completed any more.
        """
        self._is_quiet = True
        self._is_over = is_long
        if self._fresh[-1:] != [len(self._buffer)]:
            self._fresh.append(len(self._buffer))

    @property
    def end(self) -> int:
        """The end of the stream so far."""
        return self.offset + len(self._buffer)

    def take(self, is_awaited: Callable[[int, int], bool]) -> EitherWay | NoFrame | None:
        """
        Return the next frame or damage; None if more bytes, or silence, are needed.

        Args:
            is_awaited: returns True if a request with a unit and function is open, so that a
                response is likely.
        """
        data = bytes(self._buffer)
        if not data:
            return None
        fresh = self._fresh[0] if self._fresh else -1
        state = SILENT if self._is_quiet else GOES_ON
        asks, asks_at = _look(self._asking, data, 0, fresh, state)
        answers, answers_at = _look(self._answering, data, 0, fresh, state)
        if start := min(asks_at, answers_at):
            return self._skip(data, start)
        if len(data) > 1 and not data[1] & 0x7F:  # no function (application protocol, 4.1)
            return self._without_function(data, is_fresh=fresh == 0)
        awaited = len(data) > 1 and is_awaited(data[0], data[1] & 0x7F)
        first, second = (answers, asks) if awaited else (asks, answers)
        if first > 0 or (second > 0 and (first == 0 or self._is_quiet)):
            end = first if first > 0 else second
            return self._found(data, end, asks == end, answers == end)
        if start := self._later_start(data):
            return self._skip(data, start)
        return self._skip(data, 1) if self._is_over else None

    def _without_function(self, data: bytes, *, is_fresh: bool) -> EitherWay | NoFrame | None:
        """Take a frame without a function, if it is all between two silences; else skip it."""
        if not is_fresh or len(data) > MAX_PDU + 3:
            return self._skip(data, 1)
        if len(data) >= 4 and not crc16(data):
            return self._found(data, len(data), False, True)
        return self._skip(data, 1) if self._is_quiet else None

    def _later_start(self, data: bytes) -> int:
        """
        Return where to go on although the front may still be completed; 0 for nowhere.

        A damaged front may claim a length that no byte will ever fill. So a frame counts that
        begins where silence ended, and in silence frames without a gap up to the end.
        """
        for fresh in self._fresh:
            if 0 < fresh < len(data) and self._complete(data, fresh, fresh) > 0:
                return fresh
        if self._is_quiet and self._may_end_with_a_frame(data):
            tiled = (at for at in range(1, len(data)) if self._tiles(data, at))
            return next(tiled, 0)
        return 0

    def _may_end_with_a_frame(self, data: bytes) -> bool:
        scans = (self._asking, self._answering)
        for scan in scans:
            scan.fresh = -1
        return any(scan.next(data, 1, AT_END) > 0 for scan in scans)

    def _tiles(self, data: bytes, at: int) -> bool:
        while 0 < at < len(data):
            at = self._complete(data, at, -1)
        return at == len(data)

    def _complete(self, data: bytes, at: int, fresh: int) -> int:
        """Return the end of a frame that begins here; 0 or less if none does."""
        for scan in (self._asking, self._answering):
            state = SILENT if self._is_quiet else GOES_ON
            end, start = _look(scan, data, at, fresh, state)
            if start == at and end > 0:
                return end
        return 0

    def _found(self, data: bytes, end: int, may_ask: bool, may_answer: bool) -> EitherWay:
        frame = Frame(data[0], data[1 : end - 2])
        start = self.offset
        self._forget(end)
        if self._fresh[:1] != [0]:
            self._fresh.insert(0, 0)
        return EitherWay(start, self.offset, frame, may_ask, may_answer)

    def _skip(self, data: bytes, count: int) -> NoFrame:
        start = self.offset
        self._forget(count)
        return NoFrame(start, self.offset, data[:count])

    def _forget(self, count: int) -> None:
        del self._buffer[:count]
        self.offset += count
        self._fresh = [at - count for at in self._fresh if at >= count]


def _look(scan: FrameScanner, data: bytes, at: int, fresh: int, state: int) -> tuple[int, int]:
    """Return the end of the frame that begins here, 0 for none, and where one may begin."""
    scan.fresh = fresh
    end = scan.next(data, at, state)
    return (end if scan.start == at else 0), scan.start
