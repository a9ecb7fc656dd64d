"""
Frames heard on a line, of which it is not known whether they are requests or responses.

Bytes only; no clock. `RtuEitherWay` finds frames by both length rules of `pdu` and the CRC;
`may_be` asks the same rules about a frame that is already cut out, as in ASCII.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from .framing import Frame, scanner
from .pauses import ALLOWANCE
from .pdu import request_length, response_length
from .scan import AT_END, GOES_ON, MAX_ADU, MIN_ADU, SILENT, FrameScanner, crc16, is_one_adu

__all__ = ["EitherWay", "NoFrame", "RtuEitherWay", "may_be"]


class EitherWay(NamedTuple):
    """A frame whose CRC fits, by one length rule or by both; `start` and `end` in the stream."""

    start: int
    end: int
    frame: Frame
    may_ask: bool
    may_answer: bool


class NoFrame(NamedTuple):
    """Bytes that are not a frame."""

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
        if self._is_after_silence(data) and _is_for_nobody(data, max(asks, answers)):
            if is_one_adu(data):
                return self._found(data, len(data), False, False)
            if not self._is_quiet:
                return None
        if start := min(asks_at, answers_at):
            return self._skip(data, start)
        if len(data) > 1 and not data[1] & 0x7F:  # no function (application protocol, 4.1)
            return self._skip(data, 1)
        awaited = len(data) > 1 and is_awaited(data[0], data[1] & 0x7F)
        first, second = (answers, asks) if awaited else (asks, answers)
        if first > 0 or (second > 0 and (first == 0 or self._is_quiet)):
            end = first if first > 0 else second
            may_ask, may_answer = asks == end, answers == end
            if end < len(data) and _has_no_length(data[:end]):
                end = self._end_before_others(data, end)
            return self._found(data, end, may_ask, may_answer)
        if start := self._later_start(data):
            return self._skip(data, start)
        return self._skip(data, 1) if self._is_over else None

    def _is_after_silence(self, data: bytes) -> bool:
        """Return True if all that waits came between two silences, or since the last one."""
        return self._fresh[:1] == [0] and not any(0 < at < len(data) for at in self._fresh)

    def _end_before_others(self, data: bytes, end: int) -> int:
        """
        Return where a frame without a length ends, which is at `end` or earlier.

        It goes as far as its CRC fits, unless it fits at a place from which frames without a gap
        go to the silence: the master may wait for less than what separates frames here.
        """
        earlier = (at for at in _fits(data, 0, end) if self._goes_on_from(data, at))
        return next(earlier, end)

    def _goes_on_from(self, data: bytes, start: int) -> bool:
        """Return True if frames of any kind, without a gap, go from here to the end."""
        reached, seen = [start], {start}
        while reached:
            at = reached.pop()
            if at == len(data):
                return True
            end = self._complete(data, at, at)
            ends = _fits(data, at, end + 1) if _has_no_length(data[at:end]) else (end,)
            for each in ends:
                if each > at and each not in seen:
                    seen.add(each)
                    reached.append(each)
        return False

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
            end, _ = _look(scan, data, at, fresh, state)
            if end > 0:
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


def _is_for_nobody(data: bytes, end: int) -> bool:
    """
    Return True if the function at the front is none of a request, and no whole exception is there.

    That is 0 or 80h (application protocol, 4.1), and of 80h and more all but whole exceptions.
    """
    if not 1 < len(data) <= MAX_ADU:
        return False
    return not data[1] & 0x7F or (data[1] >= 0x80 and end <= 0)


def _has_no_length(adu: bytes) -> bool:
    """Return True if a frame ends with silence, by its function, as a request or a response."""
    return len(adu) >= MIN_ADU and 0 in (request_length(adu[1:]), response_length(adu[1:]))


def _fits(data: bytes, start: int, end: int) -> Iterator[int]:
    """Yield the places before `end` where the CRC of a frame fits that begins at `start`."""
    return (at for at in range(start + MIN_ADU, end) if not crc16(data[start:at]))
