"""
RTU frames in a stream of bytes: requests, responses, or both on a shared line.

Bytes only; no clock. The ends of an RTU frame are marked only by silence, which PCs cannot measure
because of their buffers. So `RtuCutter` cuts by these rules, with the CRC as the judge:

* A frame begins with the first byte, behind a silence or an answer that was sent, or right behind
  another frame. It ends where the length rule of its function says (`pdu`), or with silence if
  there is no such rule.
* An unfinished frame is waited for, also beyond a silence. It is given up if, from a later byte,
  frames without a gap go to a silence.
* What begins no frame is damage. Behind it, a client and a listener take every byte for a possible
  start. A server, which must not carry out what is within the frames of others, accepts only what
  begins behind a silence, or goes without a gap to the next one.
* A server and a listener hear requests and responses, and ask the length rules of both. A response
  is awaited if the frame before was a request to this unit and function, which is not answered
  here; it counts at once. So does a request; but a server waits, before it accepts one to
  another unit, until no rule can find a longer frame.
* No request has a function of 80h or more. A frame with one that ends with the silence is a
  response of another unit, whatever its length.
* What a server hears from silence to silence is one frame if its CRC fits, whatever its length: a
  request to a unit here, which its length makes an illegal value, or a frame of others.
* Up to `MAX_NOISE` bytes before and behind a request are noise of transceivers. A server takes a
  request out of it if the whole is no damaged or awaited frame of another unit.
* Where the CRC of a frame without a length rule fits at several bytes, a client and a listener take
  the first from which frames without a gap go to the silence. A server accepts it only if the last
  is at the silence, and else drops all up to there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Literal, NamedTuple

from . import pdu
from .pdu.request import IN_C, length_by, unknown_length
from .scan import (
    AT_END,
    GOES_ON,
    MAX_ADU,
    MAX_PDU,
    MIN_ADU,
    NO_FRAME,
    SILENT,
    UNFINISHED,
    FrameScanner,
    crc16,
    is_one_adu,
    lib,
)

Kind = Literal["request", "response", "damage"]

MAX_NOISE = 4
"""Bytes that transceivers add on one side of a frame, at most."""


class Piece(NamedTuple):
    """A part of the bytes on a line, and what it is."""

    start: int
    end: int
    kind: Kind


def has_own_length(request: pdu.Request[Any]) -> bool:
    """Return True if the rule for the response of a request is not that of its function."""
    kind = pdu.REQUESTS.get(request.function)
    usual = unknown_length if kind is None else kind.response_length
    return getattr(type(request), "response_length", usual) is not usual


def _scanner(*, is_client: bool, own: pdu.Request[Any] | None = None) -> FrameScanner:
    """Return a scanner by the rules of `pdu`, and by that of the response of an `own` request."""
    classes = dict(pdu.REQUESTS)
    if own is not None:
        classes[own.function] = type(own)
    rules = {
        code: request.response_length if is_client else request.request_length
        for code, request in classes.items()
    }
    in_c = {code: IN_C.get(rule, (lib.BY_PYTHON, 0, 0)) for code, rule in rules.items()}

    def ask(head: bytes) -> int | None:
        return length_by(classes[head[0]], rules[head[0]], head)

    return FrameScanner(is_client, in_c, ask)


def may_be(data: bytes) -> tuple[bool, bool]:
    """Return two bools by length: the PDU can be a request, and it can be a response."""
    size = len(data)
    can_ask = data[0] < 0x80 and pdu.request_length(data) in (size, 0)
    return can_ask, pdu.response_length(data) in (size, 0)


class RtuCutter:
    """
    Cuts the bytes of one line into requests, responses and damage.

    `is_ours` returns True for a unit that a server answers itself; `own` is a request that a client
    sends whose class has another length rule than its function.
    """

    def __init__(
        self,
        role: Literal["client", "server", "listener"],
        own: pdu.Request[Any] | None = None,
    ) -> None:
        self.is_ours: Callable[[int], bool] = lambda unit: True
        self._role = role
        self._is_server = role == "server"
        self._requests = None if role == "client" else _scanner(is_client=False)
        self._responses = _scanner(is_client=True, own=own)
        self._scanners = [scanner for scanner in (self._requests, self._responses) if scanner]
        self._is_fresh = True  # a frame should begin with the first byte
        self._later: list[int] = []  # where frames should begin behind an unfinished one
        self._is_lost = False  # nothing up to the next silence can be cut
        self._awaited: tuple[int, int] | None = None  # unit and function of a response

    def find_response(
        self, data: bytes, unit: int, function: int, *, is_over: bool
    ) -> bytes | None:
        """
        Return the PDU of the first response of a unit and function, whatever is around it.

        None if there is none; empty if one has begun that may still be completed, unless no more
        bytes are waited for (`is_over`). One that ends with the data counts, too, if it has another
        length than its function, and none has that.
        """
        odd = None
        for at in range(len(data) - 1):
            if data[at] == unit and data[at + 1] & 0x7F == function:
                end = self._responses.at(data, at, at, SILENT)
                if end > 0:
                    return data[at + 1 : end - 2]
                if end == UNFINISHED and not is_over:
                    return odd or b""
                if odd is None and is_one_adu(data[at:]):
                    odd = data[at + 1 : -2]
        return odd

    def is_one_frame(self, data: bytes) -> bool:
        """Return True if the data are one frame that is answered or awaited here, as most are."""
        if not self._is_fresh or self._scanners[0].at(data, 0, 0) != len(data):
            return False
        if data[0] and not self.is_ours(data[0]):
            return False
        self._later.clear()
        self._awaited = None
        return True

    def begin_anew(self, size: int) -> None:
        """Note that an answer was sent behind so many bytes: a frame should begin there."""
        if size and self._later[-1:] != [size]:
            self._later.append(size)

    def cut(
        self, data: bytes, *, is_silent: bool, is_over: bool = False
    ) -> tuple[list[Piece], int]:
        """
        Return the pieces that are certain, and the number of bytes in them.

        The data begin behind the last piece; `is_silent` if silence follows, `is_over` if that ends
        unfinished frames, too.
        """
        pieces: list[Piece] = []
        at, size = 0, len(data)
        while at < size:
            was_fresh = self._is_fresh
            end, kind = self._front(data, at, is_silent)
            if end == NO_FRAME:
                end = self._next_start(data, at)
            elif end == UNFINISHED:
                end = self._given_up(data, at, is_silent, is_over)
            else:
                self._is_fresh = True
            if end > at:
                pieces.append(Piece(at, end, kind))
                at = end
            elif self._is_fresh == was_fresh:
                break
        self._forget(at, size, is_silent)
        return pieces, at

    # --- where a frame may begin ------------------------------------------------------------

    def _front(self, data: bytes, at: int, is_silent: bool) -> tuple[int, Kind]:
        """Return the end and the kind of the frame at this position, or why there is none."""
        if self._is_server and not self._is_fresh:
            return UNFINISHED, "damage"
        asks = self._end(self._requests, data, at, is_silent)
        if asks > 0 and self._is_answered_here(data[at]):
            return self._request(data, at, asks)
        answers = self._end(self._responses, data, at, is_silent)
        is_awaited = self._is_awaited(data, at)
        is_open = UNFINISHED in (asks, answers)
        if answers > 0 and is_awaited:
            return self._response(answers)
        if asks > 0 and not (is_awaited or self._is_server):
            return self._request(data, at, asks)
        if self._is_lost or (is_open and not is_silent):
            return UNFINISHED, "damage"
        if answers > max(asks, 0):
            return self._response(answers)
        if asks > 0:
            return self._request(data, at, asks)
        if self._requests and self._is_fresh:
            end, kind = self._burst(data, at, is_silent, is_open)
            if end:
                return end, kind
        return UNFINISHED if is_open else NO_FRAME, "damage"

    def _burst(self, data: bytes, at: int, is_silent: bool, is_open: bool) -> tuple[int, Kind]:
        """Return the kind of all bytes up to a silence, taken as one frame; 0 if unknown."""
        is_high = data[at + 1 : at + 2] >= b"\x80"
        if not is_silent:
            may_wait = is_high or (self._is_server and max(self._later, default=0) <= at)
            most = MAX_ADU + 2 * MAX_NOISE if self._is_server else MAX_ADU
            return UNFINISHED if may_wait and len(data) - at <= most else 0, "damage"
        is_ours = self._is_answered_here(data[at])
        if (is_high or is_ours or (self._is_server and not is_open)) and is_one_adu(data[at:]):
            is_request = is_ours and not is_high
            return self._request(data, at, len(data)) if is_request else self._response(len(data))
        return self._start_in_noise(data, at) if self._is_server else 0, "damage"

    def _start_in_noise(self, data: bytes, at: int) -> int:
        """Return the start of a request with noise before it, and perhaps after it; else 0."""
        last = len(data) - MIN_ADU
        for place in (at, *self._later):
            for start in range(max(place, at + 1), min(place + MAX_NOISE, last) + 1):
                if self._ends_in_noise(data, start) and not self._is_within(data, at, start):
                    return start
        return 0

    def _ends_in_noise(self, data: bytes, start: int) -> bool:
        """Return True if a request of a known function to a unit here ends close to the silence."""
        assert self._requests is not None
        if not self._is_answered_here(data[start]) or data[start + 1] not in pdu.REQUESTS:
            return False
        end = self._requests.at(data, start, start, SILENT)
        return end >= len(data) - MAX_NOISE and self._requests.fits == 1

    def _is_within(self, data: bytes, at: int, start: int) -> bool:
        """Return True if bytes like a request may be data of another unit's frame."""
        size = len(data)
        behind = range(size - MAX_NOISE, size + 1)
        if any(is_one_adu(data[first:end]) for first in range(at, start) for end in behind):
            return True
        # The data of a response begin with its fourth byte. This one is damaged or has a gap.
        if start < at + 3 or self._is_answered_here(data[at]):
            return False
        length = pdu.response_length(data[at + 1 : at + 1 + MAX_PDU])
        return self._is_awaited(data, at) or length == size - at - 3

    def _is_answered_here(self, unit: int) -> bool:
        return self._is_server and (unit == 0 or self.is_ours(unit))

    def _is_awaited(self, data: bytes, at: int) -> bool:
        return len(data) > at + 1 and self._awaited == (data[at], data[at + 1] & 0x7F)

    def _request(self, data: bytes, at: int, end: int) -> tuple[int, Kind]:
        unit, function = data[at], data[at + 1]
        self._awaited = None if self._is_answered_here(unit) else (unit, function)
        return end, "request"

    def _response(self, end: int) -> tuple[int, Kind]:
        self._awaited = None
        return end, "response"

    def _end(self, scanner: FrameScanner | None, data: bytes, at: int, is_silent: bool) -> int:
        if scanner is None:
            return NO_FRAME
        fresh = at if self._is_fresh else -1
        end = scanner.at(data, at, fresh, SILENT if is_silent else GOES_ON)
        if end <= 0 or scanner.fits < 2:
            return end
        if self._is_server:
            self._is_lost = end < len(data)
            self._is_fresh = not self._is_lost
            return NO_FRAME if self._is_lost else end
        return next((place for place in _fits(data, at, end) if self._goes_on(data, place)), end)

    # --- damage -----------------------------------------------------------------------------

    def _next_start(self, data: bytes, at: int) -> int:
        """Return the first byte behind a wrong one with which a frame may begin."""
        starts = later = [place for place in self._later if place > at][:1]
        if not (later and self._is_server):
            frames = [self._search(scanner, data, at + 1, GOES_ON) for scanner in self._scanners]
            starts = [*later, *(start for _, start in frames)]
        start = min(starts)
        self._is_fresh = start in later
        return start

    def _given_up(self, data: bytes, at: int, is_silent: bool, is_over: bool) -> int:
        """Return where to go on, although a frame is unfinished here; `at` for nowhere."""
        later = [place for place in self._later if place > at]
        is_kept = self._is_fresh or not self._is_server
        if is_silent and self._is_lost:
            return len(data)
        if is_silent:
            starts = range(at, len(data)) if self._may_end_later(data, at) else later
            places = (place for place in starts if self._goes_on(data, place, place in later))
        elif self._role == "listener":
            scanners = self._scanners
            places = (at for at in later if any(one.at(data, at, at) > 0 for one in scanners))
        else:
            return at if is_kept else max(at, len(data) - MAX_ADU)
        if (place := next(places, -1)) >= 0:
            self._is_fresh = True
            return place
        if is_over:
            return self._next_start(data, at)
        return at if is_kept else len(data)

    def _may_end_later(self, data: bytes, at: int) -> bool:
        """Return True if a frame with a length rule, found behind damage, ends with the data."""
        if self._is_fresh and self._may_go_on(data, at):
            return False
        return max(self._search(scanner, data, at, AT_END)[0] for scanner in self._scanners) > 0

    def _may_go_on(self, data: bytes, at: int) -> bool:
        """Return True for a server in an unfinished frame of another unit, with a gap so far."""
        if not self._is_server or self._is_answered_here(data[at]):
            return False
        # Without a length it may as well be noise.
        return self._is_awaited(data, at) or all(scanner.fits > 0 for scanner in self._scanners)

    def _search(self, scanner: FrameScanner, data: bytes, at: int, state: int) -> tuple[int, int]:
        """Return the end of the first frame of a function with a length rule, and its start."""
        scanner.fresh = -1
        return scanner.next(data, at, state), scanner.start

    def _goes_on(self, data: bytes, start: int, is_fresh: bool = True) -> bool:
        """Return True if frames without a gap go from here to the silence at the end."""
        stack, places = [start], {start}
        while stack:
            at = stack.pop()
            if at == len(data):
                return True
            fresh = at if is_fresh or at > start else -1
            for scanner in self._scanners:
                end = scanner.at(data, at, fresh, SILENT)
                ends = _fits(data, at, end + 1) if scanner.fits > 1 else (end,)
                new = {place for place in ends if place > at} - places
                places |= new
                stack += new
        return False

    def _forget(self, count: int, size: int, is_silent: bool) -> None:
        self._later = [fresh - count for fresh in self._later if fresh > count]
        if is_silent:
            self._is_lost = False
            if count == size:
                self._is_fresh = True
            else:
                self.begin_anew(size - count)


def _fits(data: bytes, start: int, end: int) -> Iterator[int]:
    """Yield the ends before `end` at which the CRC of a frame that begins at `start` fits."""
    return (at for at in range(start + MIN_ADU, end) if not crc16(data[start:at]))
