"""
Cuts bytes into frames, which may be requests or responses, and bytes that are not a frame.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator
from typing import NamedTuple, Protocol

from ...protocol.errors import MAX_RECEIVED, FrameError
from ...protocol.framing import Frame, Framer, Overheard
from ...protocol.rtu import RtuCutter, may_be
from ...protocol.scan import ALLOWANCE

__all__ = ["Candidate", "Damage", "FramerHearing", "Hearing", "RtuHearing"]


class Candidate(NamedTuple):
    """A valid frame with its times, which may be a request, a response, or either."""

    began: float
    ended: float
    frame: Frame
    may_ask: bool
    may_answer: bool


class Damage(NamedTuple):
    """Bytes that are not a frame, at most 600."""

    began: float
    ended: float
    data: bytes


class Hearing(Protocol):
    """Cuts frames. Call `silence` after `quiet` seconds without a byte."""

    quiet: float

    def hear(self, data: bytes, at: float) -> Iterator[Candidate | Damage]:
        """Take bytes and the time of their arrival in seconds; yield frames and damage in order."""
        ...

    def silence(self, *, is_long: bool = False) -> Iterator[Candidate | Damage]:
        """Note that the line is quiet; if `is_long`, for too long to complete a pending frame."""
        ...


class RtuHearing:
    """Cuts requests and responses in one stream, as on a line; each frame has its own time."""

    def __init__(self, pause: float = 0.0) -> None:
        self.quiet: float = pause + ALLOWANCE
        self._cutter = RtuCutter("listener")
        self._data = b""
        self._start = 0  # where these data begin in the stream
        self._offsets: list[int] = []  # where in the stream each piece begins
        self._times: list[float] = []  # when each piece arrived
        self._damage: Damage | None = None

    def hear(self, data: bytes, at: float) -> Iterator[Candidate | Damage]:
        # At most one for each byte that waits for the rest of its frame.
        self._offsets.append(self._start + len(self._data))
        self._times.append(at)
        self._data += data
        yield from self._take(is_silent=False)

    def silence(self, *, is_long: bool = False) -> Iterator[Candidate | Damage]:
        yield from self._take(is_silent=True, is_over=is_long)
        # Bytes that still wait may belong to the same damage.
        if not self._data:
            yield from self._flush()

    def _take(self, *, is_silent: bool, is_over: bool = False) -> Iterator[Candidate | Damage]:
        data, offset = self._data, self._start
        pieces, count = self._cutter.cut(data, is_silent=is_silent, is_over=is_over)
        self._data, self._start = data[count:], offset + count
        for start, end, kind in pieces:
            began, ended = self._time(offset + start), self._time(offset + end - 1)
            if kind == "damage":
                yield from self._add(Damage(began, ended, data[start:end]))
            else:
                yield from self._flush()
                frame = Frame(data[start], data[start + 1 : end - 2])
                yield Candidate(began, ended, frame, *may_be(frame.pdu))
        self._forget()

    def _add(self, damage: Damage) -> Iterator[Damage]:
        """Join bytes that are not a frame to one `Damage`, up to `MAX_RECEIVED` bytes."""
        if self._damage is None:
            self._damage = damage
        else:
            began, _, data = self._damage
            self._damage = Damage(began, damage.ended, data + damage.data)
        if len(self._damage.data) >= MAX_RECEIVED:
            yield from self._flush()

    def _flush(self) -> Iterator[Damage]:
        damage, self._damage = self._damage, None
        if damage is None:
            return
        for at in range(0, len(damage.data), MAX_RECEIVED):
            yield damage._replace(data=damage.data[at : at + MAX_RECEIVED])

    def _time(self, offset: int) -> float:
        return self._times[bisect_right(self._offsets, offset) - 1]

    def _forget(self) -> None:
        done = max(bisect_right(self._offsets, self._start) - 1, 0)
        del self._offsets[:done]
        del self._times[:done]


class FramerHearing:
    """
    Cuts frames with a framer; the time of each frame is that of the piece that ends it.

    Args:
        make_framer: makes a framer for one direction of RTU, or for ASCII, whose frames have
            delimiters.
        is_asking: True for the direction of requests; None for both directions in one stream.
    """

    def __init__(self, make_framer: Callable[[], Framer], is_asking: bool | None) -> None:
        self._make_framer = make_framer
        self._framer = make_framer()
        self._tail = b""  # bytes in the framer that wait for the rest of their frame
        self._is_asking = is_asking
        self._began: float | None = None
        self._at = 0.0
        self.quiet: float = self._framer.quiet or 0.0

    def hear(self, data: bytes, at: float) -> Iterator[Candidate | Damage]:
        self._at = at
        began = at if self._began is None else self._began
        found = self._framer.scan(data)
        pending, data = self._framer.pending, self._tail + data
        self._tail = data[-pending:] if pending else b""
        if not found and not pending:  # skipped bytes, such as those before a colon
            yield Damage(began, at, data[:MAX_RECEIVED])
        for each in found:
            yield self._heard(each, began)
            began = at
        if not self._framer.pending:
            self._began = None
        elif self._began is None or found:
            self._began = at

    def silence(self, *, is_long: bool = False) -> Iterator[Candidate | Damage]:
        began = self._at if self._began is None else self._began
        for each in self._framer.scan_silence():
            yield self._heard(each, began)
        if is_long and self._framer.pending:
            yield Damage(began, self._at, self._tail[-self._framer.pending :])
            self._framer = self._make_framer()
        if not self._framer.pending:
            self._began = None

    def _heard(self, found: Frame | FrameError, began: float) -> Candidate | Damage:
        if isinstance(found, FrameError):
            return Damage(began, self._at, found.received)
        if isinstance(found, Overheard) and found.pdu[0] < 0x80:  # clients send no responses
            return Damage(began, self._at, self._framer.encode(found))
        is_asking = self._is_asking
        either = may_be(found.pdu) if is_asking is None else (is_asking, not is_asking)
        return Candidate(began, self._at, found, *either)
