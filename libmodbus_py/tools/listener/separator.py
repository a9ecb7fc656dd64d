"""
From the bytes of one line or connection to transactions, without clocks or ports.

1. Bytes to frames. `RtuCutter` cuts RTU by the length rules of both directions, with the CRC as the
   judge; ASCII frames have marks. What is not a frame is damage.
2. A frame is a request or a response by its sender, if that is known, or by its length, if only
   one of the two has it. Otherwise it is a response if it fits the open request as one, and no
   request.
3. Some frames could be both: the responses to single writes are equal to their requests, and those
   with three bytes of bits are as long. Then time decides: such a frame is the response if it comes
   as quickly as this unit usually responds, and the request again if it comes as late as clients
   usually give up. The limit is the geometric mean of both times, which are learnt from frames that
   could not be both.
4. So it is decided afterwards about an open request that could have been a response: if the next
   request comes so soon that no client waited for a response to it, it was one. Its own request was
   damaged, or it came twice.
5. `pairing` decides to which request a response belongs, and how each request ended.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import defaultdict, deque
from collections.abc import Iterator
from typing import Literal, NamedTuple

from ...protocol.checks import checked_callback
from ...protocol.errors import MAX_RECEIVED, FrameError
from ...protocol.framing import AsciiFramer, Frame
from ...protocol.rtu import RtuCutter, may_be
from ...protocol.scan import ALLOWANCE
from .pairing import OpenRequest, Pairing
from .transaction import OnHeard, Part, TimedFrame, Transaction, decoded

LineFraming = Literal["rtu", "ascii"]

Direction = Literal["client", "server"]
"""The sender of bytes."""

# Sender of bytes -> the rules for them; those for both directions wait for silence more often.
RECEIVERS: dict[Direction | None, Literal["client", "server", "listener"]] = {
    "client": "server",
    "server": "client",
    None: "listener",
}

# The longest gap inside a frame, in seconds: that of ASCII (serial line, 2.5.2.1), which is longer
# than that of RTU.
LONGEST_GAP = 1.0

# A frame that follows damaged bytes within this time was sent together with them; in seconds.
GLUED = 0.001

# Until some times are known, in seconds: clients wait for half a second (libmodbus) or longer, and
# adapters delay responses by up to 20 ms.
USUAL_TIMEOUT = 0.5
SHORTEST_ANSWER = 0.02


class Candidate(NamedTuple):
    """A valid frame with its times, which may be a request, a response, or either."""

    began: float
    ended: float
    frame: Frame
    may_ask: bool
    may_answer: bool


class Damage(NamedTuple):
    """Bytes that are not a frame, at most `MAX_RECEIVED`."""

    began: float
    ended: float
    data: bytes


FoundUnit = Iterator[Candidate | Damage]


class _RtuHearing:
    """Cuts a stream of RTU; each frame has the times of its first and its last byte."""

    def __init__(self, pause: float, sender: Direction | None) -> None:
        self.quiet: float = pause + ALLOWANCE
        self._cutter = RtuCutter(RECEIVERS[sender])
        self._data = b""
        self._start = 0  # where these data begin in the stream
        self._offsets: list[int] = []  # where in the stream each piece begins
        self._times: list[float] = []  # when each piece arrived
        self._damage: Damage | None = None  # more bytes may belong to it

    def split(self, data: bytes, at: float) -> FoundUnit:
        # At most one for each byte that waits for the rest of its frame.
        self._offsets.append(self._start + len(self._data))
        self._times.append(at)
        self._data += data
        yield from self._cut(is_silent=False)

    def silence(self, *, is_over: bool) -> FoundUnit:
        yield from self._cut(is_silent=True, is_over=is_over)
        if not self._data:
            yield from self._flush()

    def _cut(self, *, is_silent: bool, is_over: bool = False) -> FoundUnit:
        data, offset = self._data, self._start
        pieces, count = self._cutter.cut(data, is_silent=is_silent, is_over=is_over)
        self._data, self._start = data[count:], offset + count
        for start, end, kind in pieces:
            began, ended = self._time(offset + start), self._time(offset + end - 1)
            if kind == "damage":
                before = self._damage or Damage(began, ended, b"")
                self._damage = Damage(before.began, ended, before.data + data[start:end])
                if len(self._damage.data) >= MAX_RECEIVED:
                    yield from self._flush()
            else:
                yield from self._flush()
                frame = Frame(data[start], data[start + 1 : end - 2])
                yield Candidate(began, ended, frame, *may_be(frame.pdu))
        index = max(bisect_right(self._offsets, self._start) - 1, 0)
        del self._offsets[:index], self._times[:index]

    def _flush(self) -> Iterator[Damage]:
        damage, self._damage = self._damage, None
        if damage is not None:
            for at in range(0, len(damage.data), MAX_RECEIVED):
                yield damage._replace(data=damage.data[at : at + MAX_RECEIVED])

    def _time(self, offset: int) -> float:
        return self._times[bisect_right(self._offsets, offset) - 1]


class _AsciiHearing:
    """As `_RtuHearing`; each frame has the times of the pieces that begin and end it."""

    def __init__(self) -> None:
        self.framer = AsciiFramer()
        self._began: float | None = None  # when the frame began that is not finished
        self._at = 0.0

    @property
    def quiet(self) -> float:
        return self.framer.quiet

    def split(self, data: bytes, at: float) -> FoundUnit:
        self._at = at
        began = at if self._began is None else self._began
        items = self.framer.scan(data)
        if not items and not self.framer.pending:  # skipped bytes, such as those before a colon
            yield Damage(began, at, data[:MAX_RECEIVED])
        yield from self._candidates(items, began)
        if not self.framer.pending:
            self._began = None
        elif self._began is None or items:
            self._began = at

    def silence(self, *, is_over: bool) -> FoundUnit:
        began = self._at if self._began is None else self._began
        yield from self._candidates(self.framer.scan_silence(), began)
        self._began = None

    def _candidates(self, items: list[Frame | FrameError], began: float) -> FoundUnit:
        for item in items:
            if isinstance(item, FrameError):
                yield Damage(began, self._at, item.received)
            else:
                yield Candidate(began, self._at, item, *may_be(item.pdu))
            began = self._at


class _LearntTimes:
    """The last response times of units, and times until clients sent the next request instead."""

    def __init__(self) -> None:
        self.answers: defaultdict[int, deque[float]] = defaultdict(lambda: deque(maxlen=32))
        self.timeouts: deque[float] = deque(maxlen=16)

    def limit(self, unit: int) -> float:
        """Return the seconds after a request up to which equal bytes are its response."""
        slowest = max(self.answers.get(unit, ()), default=0.0)
        # One of the shortest times, because clients may pause before the next request; but not the
        # shortest, because a frame that is merged into a damaged one looks like a request.
        units = sorted(self.timeouts)
        timeout = units[len(units) // 4] if len(units) >= 4 else USUAL_TIMEOUT
        return math.sqrt(max(slowest, min(SHORTEST_ANSWER, timeout / 4)) * timeout)


class Separator:
    """
    Separates the bytes on a line into requests, responses and damage, and pairs them.

    Args:
        framing: "rtu" or "ascii".
        on_heard: called with a `TimedFrame` for each frame as soon as it is known to be a request
            or a response, and for damaged bytes.
        pause: the seconds between two frames on an RTU line, as `pause_between_frames` returns;
            0 if bytes do not arrive at the pace of a serial line.

    Attributes:
        quiet: seconds without a byte after which `tick` should be called.

    Raises:
        ValueError: `framing` is wrong.
        TypeError: `on_heard` is not a function.
    """

    def __init__(
        self, framing: LineFraming, on_heard: OnHeard = lambda event: None, pause: float = 0.0
    ) -> None:
        if framing not in ("rtu", "ascii"):
            raise ValueError(f'framing must be "rtu" or "ascii", not {framing!r}')
        checked_callback("on_heard", on_heard)
        self._framing = framing
        self._pause = pause
        self._on_heard = on_heard
        self._pairing = Pairing()
        self._times = _LearntTimes()
        self._is_certain = True  # the open request cannot be a response
        self._doubtful: TimedFrame | None = None  # a request that may turn out to be a response
        self._hearings: dict[Direction | None, _RtuHearing | _AsciiHearing] = {}
        self._last: dict[Direction | None, float] = {}
        self._is_quiet: set[Direction | None] = set()
        self.quiet: float = self._hearing(None).quiet

    def feed(self, data: bytes, at: float, direction: Direction | None = None) -> list[Transaction]:
        """
        Take received bytes, and return the transactions that have ended, oldest first.

        Args:
            data: the bytes, cut anywhere.
            at: the time at which they arrived, in seconds of any clock that never goes back.
            direction: the sender of the bytes, "client" or "server"; None if it is not known.
        """
        self._wait(at)
        if data:
            self._last[direction] = at
            self._is_quiet.discard(direction)
            self._take(direction, self._hearing(direction).split(data, at))
        return self._new_transactions()

    def tick(self, at: float) -> list[Transaction]:
        """Note that no more bytes arrived until this time; otherwise like `feed`."""
        self._wait(at)
        self._pairing.tick(at)
        self._release()
        return self._new_transactions()

    def end(self) -> list[Transaction]:
        """Note that no more bytes will arrive; otherwise like `feed`."""
        for direction, hearing in self._hearings.items():
            self._take(direction, hearing.silence(is_over=True))
        self._last.clear()
        self._pairing.tick(math.inf)
        self._release()
        return self._new_transactions()

    def take(self, item: Candidate | Damage) -> list[Transaction]:
        """Take a frame or damaged bytes that were separated before; otherwise like `feed`."""
        self._name(item)
        return self._new_transactions()

    def _wait(self, at: float) -> None:
        for direction, last in list(self._last.items()):
            hearing = self._hearing(direction)
            is_over = at - last >= LONGEST_GAP
            if is_over or (at - last >= hearing.quiet and direction not in self._is_quiet):
                self._is_quiet.add(direction)
                self._take(direction, hearing.silence(is_over=is_over))
            if is_over:
                del self._last[direction]

    def _take(self, direction: Direction | None, items: FoundUnit) -> None:
        asks = direction == "client"
        for item in items:
            if direction is None or isinstance(item, Damage):
                self._name(item)
            else:
                self._name(item._replace(may_ask=asks, may_answer=not asks))

    def _new_transactions(self) -> list[Transaction]:
        pairs, self._pairing.done = self._pairing.done, []
        return pairs

    def _hearing(self, direction: Direction | None) -> _RtuHearing | _AsciiHearing:
        if direction not in self._hearings:
            if self._framing == "ascii":
                self._hearings[direction] = _AsciiHearing()
            else:
                self._hearings[direction] = _RtuHearing(self._pause, direction)
        return self._hearings[direction]

    def _name(self, item: Candidate | Damage) -> None:
        """Decide what the next frame is, and pair it."""
        began, ended = item.began, item.ended
        self._pairing.tick(began)
        if isinstance(item, Damage):
            self._report(TimedFrame(began, ended, "damage", None, item.data))
            self._pairing.damage(*item)
            return
        code = item.frame.pdu[0]
        if not code & 0x7F or (code > 0x80 and not item.may_answer):  # application protocol, 4.1
            part: Part = "response" if item.may_answer else "request"
            self._report(TimedFrame(began, ended, part, item.frame))
            self._pairing.misuse(began, ended, item.frame)
        elif self._is_request(item):
            self._take_request(item)
        else:
            self._report(TimedFrame(began, ended, "response", item.frame))
            request = self._pairing.due
            outcome = self._pairing.answer(began, ended, item.frame)
            if request is not None and outcome is not None and outcome.kind != "invalid":
                self._times.answers[item.frame.unit].append(max(began - request.ended, 0.0))

    def _release(self) -> None:
        """Release the held request: after it is given up, it cannot turn out to be a response."""
        if self._pairing.due is None:
            self._report(None)

    def _report(self, event: TimedFrame | None) -> None:
        """Call `on_heard` in the order of the line: first with the request that was held."""
        former, self._doubtful = self._doubtful, None
        for item in (former, event):
            if item is not None:
                self._on_heard(item)

    def _is_request(self, candidate: Candidate) -> bool:
        if candidate.may_ask != candidate.may_answer:
            return candidate.may_ask
        request = self._pairing.due
        asks = candidate.may_ask and decoded(candidate.frame.pdu) is not None
        answers = candidate.may_answer and request is not None and request.fits(candidate.frame)
        if asks and answers and request is not None:
            return self._is_repeated(request, candidate)
        if asks:
            return not self._is_late_echo(candidate)
        return not answers and not (request is not None and request.is_for(candidate.frame))

    def _is_repeated(self, request: OpenRequest, candidate: Candidate) -> bool:
        """Return True if a frame that could be both arrived too late for a response."""
        is_spoiled = request.spoiled
        if is_spoiled is not None and candidate.began - is_spoiled.ended > GLUED:
            return True  # the damaged bytes were the response
        return not self._is_soon(request, candidate.began)

    def _is_late_echo(self, candidate: Candidate) -> bool:
        """Return True for the response to an earlier request while another one is awaited."""
        request, late = self._pairing.due, self._pairing.unanswered_request(candidate.frame.unit)
        if request is None or request.spoiled or late is None or not late.fits(candidate.frame):
            return False
        return candidate.began - request.ended <= self._times.limit(candidate.frame.unit)

    def _is_soon(self, request: OpenRequest, at: float) -> bool:
        return at - request.ended <= self._times.limit(request.frame.unit)

    def _take_request(self, candidate: Candidate) -> None:
        before, began = self._pairing.due, candidate.began
        if before is not None and before.spoiled is None:
            if not self._is_certain and self._is_soon(before, began):  # it was a response
                self._doubtful = self._doubtful and self._doubtful._replace(part="response")
                self._pairing.withdraw(before)
            elif self._is_certain and not candidate.may_answer:
                # Times are not learnt from guesses, because they decide the next guess.
                self._times.timeouts.append(began - before.ended)
        event = TimedFrame(began, candidate.ended, "request", candidate.frame)
        self._report(None if candidate.may_answer else event)
        self._doubtful = event if candidate.may_answer else None
        self._is_certain = not candidate.may_answer
        self._pairing.ask(began, candidate.ended, candidate.frame)
        self._release()
