"""
The search for requests on a line where other units answer, too.

Bytes only; no clock. `RequestSearch` tells requests, the answers of other units and damage apart.
What is within a frame is never taken for one:

* Where a frame should begin, both length rules are asked, that of the request and that of the
  answer, and the frame is one that fits one of them.
* What fits neither is damage up to the next silence. A request in it counts only if it ends with
  that silence.
* No request has a function of 80h or more. A frame with one that is all between two silences, and
  whose CRC fits, is an answer of others, whatever its length: no damage, and no request within it.
* A frame whose function tells no length ends with silence. If its CRC fits at several places and
  the last is not at the silence, nothing tells where it ends, and all is dropped.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

from .scan import (
    AT_END,
    GOES_ON,
    MAX_ADU,
    NO_FRAME,
    SILENT,
    UNFINISHED,
    FrameScanner,
    is_one_adu,
)

__all__ = ["Piece", "RequestSearch"]

Kind = Literal["request", "answer", "damage"]


class Piece(NamedTuple):
    """A part of the bytes on a line: a request, an answer of another unit, or damage."""

    start: int
    end: int
    kind: Kind


class RequestSearch:
    """
    Divides the bytes that a server receives.

    Args:
        asking, answering: find requests and answers.

    Attributes:
        is_ours: returns True if the server answers a unit, so that no answer of it is heard.
    """

    def __init__(self, asking: FrameScanner, answering: FrameScanner) -> None:
        self.is_ours: Callable[[int], bool] = lambda unit: True
        self._asking = asking
        self._answering = answering
        self._is_fresh = True  # a frame should begin with the first byte
        self._later: list[int] = []  # where frames should begin behind an unfinished one
        self._is_lost = False  # nothing up to the next silence can be told apart
        self._awaited: tuple[int, int] | None = None  # unit and function of an answer

    def is_one_request(self, data: bytes) -> bool:
        """Return True if the data are one request to a unit of ours, as most are."""
        if not self._is_fresh or self._asking.at(data, 0, 0) != len(data):
            return False
        if data[0] and not self.is_ours(data[0]):
            return False
        self._later.clear()
        self._awaited = None
        return True

    def search(self, data: bytes, *, is_silent: bool) -> tuple[list[Piece], int]:
        """
        Return the pieces that are certain, and the number of bytes in them.

        Args:
            data: the bytes behind the last piece that was returned, with those that came since.
            is_silent: True if silence followed them.
        """
        pieces: list[Piece] = []
        at, size = 0, len(data)
        while at < size:
            was_fresh = self._is_fresh
            end, kind = self._front(data, at, is_silent) if was_fresh else _NOTHING
            if end <= 0:
                end, kind = self._damage_end(data, at, end, is_silent), "damage"
            if end > at:
                pieces.append(Piece(at, end, kind))
                at = end
            elif self._is_fresh == was_fresh:
                break
        self._forget(at, size, is_silent)
        return pieces, at

    # --- where a frame should begin ---------------------------------------------------------

    def _front(self, data: bytes, at: int, is_silent: bool) -> tuple[int, Kind]:
        """Return the end and the kind of the frame that begins here, or why there is none."""
        is_ours = data[at] == 0 or self.is_ours(data[at])
        asks = self._end(self._asking, data, at, is_silent)
        if asks > 0 and is_ours:
            self._awaited = None
            return asks, "request"
        answers = self._end(self._answering, data, at, is_silent)
        if UNFINISHED in (asks, answers) and not is_silent:
            return self._front_so_far(data, at, answers)
        # If both fit, nothing within the longer one may count.
        if answers > 0 and (answers > asks or self._is_awaited(data, at)):
            self._awaited = None
            return answers, "answer"
        if asks > 0:
            self._awaited = data[at], data[at + 1]
            return asks, "request"
        if data[at + 1 : at + 2] >= b"\x80":  # no request, but perhaps a whole frame of others
            if not is_silent and len(data) - at <= MAX_ADU:
                return UNFINISHED, "damage"
            if is_silent and is_one_adu(data[at:]):
                self._awaited = None
                return len(data), "answer"
        is_open = UNFINISHED in (asks, NO_FRAME if is_ours else answers)
        return UNFINISHED if is_open else NO_FRAME, "damage"

    def _front_so_far(self, data: bytes, at: int, answers: int) -> tuple[int, Kind]:
        """As `_front`, while a longer frame may still come: only an awaited answer is certain."""
        if answers > 0 and self._is_awaited(data, at):
            self._awaited = None
            return answers, "answer"
        return UNFINISHED, "damage"

    def _end(self, scanner: FrameScanner, data: bytes, at: int, is_silent: bool) -> int:
        end = scanner.at(data, at, at, SILENT if is_silent else GOES_ON)
        if 0 < end < len(data) and scanner.fits > 1:
            self._is_lost = True
            return NO_FRAME
        return end

    def _is_awaited(self, data: bytes, at: int) -> bool:
        return len(data) > at + 1 and self._awaited == (data[at], data[at + 1] & 0x7F)

    # --- damage -----------------------------------------------------------------------------

    def _damage_end(self, data: bytes, at: int, front: int, is_silent: bool) -> int:
        """Return the end of the bytes that are certainly no frame; `at` for none."""
        if self._is_lost:
            self._is_fresh = False
            return len(data) if is_silent else len(data) - 1
        if self._is_fresh and front == NO_FRAME:
            later = next((fresh for fresh in self._later if fresh > at), 0)
            self._is_fresh = bool(later)
            return later or self._first_start(data, at + 1)
        if is_silent:
            return self._end_in_silence(data, at)
        return at if self._is_fresh else max(at, len(data) - MAX_ADU)

    def _end_in_silence(self, data: bytes, at: int) -> int:
        starts = [fresh for fresh in self._later if fresh > at and self._tiles(data, fresh)]
        if not (self._is_fresh and self._may_go_on(data, at)):
            starts += self._starts_of_last(data, at)
        if starts:
            self._is_fresh = True
            return min(starts)
        return at if self._is_fresh else len(data)

    def _may_go_on(self, data: bytes, at: int) -> bool:
        """Return True if the unfinished frame is for or from another unit, with a gap so far."""
        if data[at] == 0 or self.is_ours(data[at]):
            return False
        # Without a length it may as well be noise.
        has_length = self._asking.fits > 0 and self._answering.fits > 0
        return has_length or self._is_awaited(data, at)

    def _first_start(self, data: bytes, at: int) -> int:
        """Return the first place where a frame may begin."""
        starts = []
        for scanner in (self._asking, self._answering):
            scanner.fresh = -1
            scanner.next(data, at)
            starts.append(scanner.start)
        return min(starts)

    def _starts_of_last(self, data: bytes, at: int) -> list[int]:
        """Return where frames may begin that end with the data."""
        starts = []
        for scanner in (self._asking, self._answering):
            scanner.fresh = -1
            if scanner.next(data, at, AT_END) > 0:
                starts.append(scanner.start)
        return starts

    def _tiles(self, data: bytes, at: int) -> bool:
        """Return True if frames without a gap go from here to the silence."""
        while 0 < at < len(data):
            ends = (each.at(data, at, at, SILENT) for each in (self._asking, self._answering))
            at = max(ends)
        return at == len(data)

    def _forget(self, count: int, size: int, is_silent: bool) -> None:
        self._later = [fresh - count for fresh in self._later if fresh > count]
        if is_silent:
            self._is_lost = False
            if count == size:
                self._is_fresh = True
            elif self._later[-1:] != [size - count]:
                self._later.append(size - count)


_NOTHING: tuple[int, Kind] = (NO_FRAME, "damage")
