"""
Turns the bytes of one line or connection into frames, which may be requests or responses, damage,
and transactions, without clocks or ports.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterator
from math import sqrt
from typing import Literal, NamedTuple

from ...protocol.checks import checked_callback
from ...protocol.errors import MAX_RECEIVED, FrameError
from ...protocol.framing import AsciiFramer, Frame, Framer, Overheard, RtuFramer, delimiter_after
from ...protocol.pdu import Diagnostics
from ...protocol.rtu import RtuCutter, may_be
from ...protocol.scan import ALLOWANCE
from .pairing import OpenRequest, Pairing
from .transaction import Heard, OnHeard, Part, Transaction, answered, decoded

# fmt: off
__all__ = [
    "Candidate", "Damage", "Direction", "LineFraming",     "Separator",
]
# fmt: on

# --- frames ---------------------------------------------------------------------------------------


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


class _RtuHearing:
    """
    Cuts requests and responses in one stream, as on a line; each frame has its own time.

    Call `silence` after `quiet` seconds without a byte; with `is_long` if that is too long for a
    pending frame to be completed.
    """

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


class _FramerHearing:
    """As `_RtuHearing`, with a framer: each frame has the time of the piece that ends it."""

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


_Hearing = _RtuHearing | _FramerHearing


# --- requests or responses ------------------------------------------------------------------------

# A frame that follows damaged bytes within this time was sent together with them; in seconds.
GLUED = 0.001


class LearntTimes:
    """
    Recent response times of the units of a line, and times until its clients send the next request.

    Only the last few of each are kept. Until some are known, typical times are assumed: clients
    wait for half a second (libmodbus) or longer, and adapters delay responses by up to 20 ms.
    """

    USUAL_TIMEOUT = 0.5
    SHORTEST_ANSWER = 0.02

    def __init__(self) -> None:
        self._answers: dict[int, deque[float]] = {}
        self._timeout: deque[float] = deque(maxlen=16)

    def note_answer(self, unit: int, seconds: float) -> None:
        self._answers.setdefault(unit, deque(maxlen=32)).append(seconds)

    def note_next_request(self, seconds: float) -> None:
        """Take the seconds between a request without a response and the next request."""
        self._timeout.append(seconds)

    def limit(self, unit: int) -> float:
        """Return the seconds after a request up to which equal bytes are its response."""
        slowest = max(self._answers.get(unit, ()), default=0.0)
        # One of the shortest times, because clients may pause before the next request; but not the
        # shortest, because a frame that is merged into a damaged one looks like a request.
        known = sorted(self._timeout)
        timeout = known[len(known) // 4] if len(known) >= 4 else self.USUAL_TIMEOUT
        return sqrt(max(slowest, min(self.SHORTEST_ANSWER, timeout / 4)) * timeout)


class _Naming:
    """
    Decides which frames are requests and which are responses, and pairs them.

    Args:
        on_heard: called with each frame as soon as this is decided, and with damaged bytes.

    Attributes:
        pairing: the transactions.
    """

    def __init__(self, on_heard: OnHeard = lambda heard: None) -> None:
        self.pairing: Pairing = Pairing()
        self._on_heard = on_heard
        self._times = LearntTimes()
        self._is_certain = True  # the open request cannot be a response
        self._held: Heard | None = None  # a request that may turn out to be a response

    def is_awaited(self, unit: int, function: int) -> bool:
        """Return True if a response of this unit to this function is likely now."""
        asked = self.pairing.due
        return asked is not None and asked.frame.unit == unit and asked.frame.pdu[0] == function

    def take(self, found: Candidate | Damage) -> None:
        """Take the next frame or damage."""
        self.pairing.tick(found.began)
        if isinstance(found, Candidate) and not _has_function(found):
            part: Part = "response" if found.may_answer else "request"
            self._note(Heard(found.began, found.ended, part, found.frame))
            self.pairing.misuse(found.began, found.ended, found.frame)
        elif isinstance(found, Damage):
            self._note(Heard(found.began, found.ended, "damage", None, found.data))
            self.pairing.damage(*found)
        elif self._is_request(found):
            self._take_request(found)
        else:
            self._note(Heard(found.began, found.ended, "response", found.frame))
            self._take_response(found)

    def tick(self, at: float) -> None:
        """Note that nothing more was received until this time."""
        self.pairing.tick(at)
        self._release()

    def end(self) -> None:
        """Note that nothing more will be received."""
        self.pairing.end()
        self._release()

    def _release(self) -> None:
        """Release the held request: after it is given up, it cannot turn out to be a response."""
        if self.pairing.due is None:
            self._note(None)

    def _note(self, heard: Heard | None) -> None:
        """Call `on_heard` in the order of the line: first with the request that was held."""
        held, self._held = self._held, None
        for each in (held, heard):
            if each is not None:
                self._on_heard(each)

    # --- request or response --------------------------------------------------------------

    def _is_request(self, found: Candidate) -> bool:
        if found.may_ask != found.may_answer:
            return found.may_ask
        asked = self.pairing.due
        asks = found.may_ask and decoded(found.frame.pdu) is not None
        answers = found.may_answer and _fits(asked, found)
        if asks and answers and asked is not None:
            return self._is_repeated(asked, found)
        if asks:
            return not self._is_late_echo(found)
        return not answers and not self.is_awaited(found.frame.unit, found.frame.pdu[0] & 0x7F)

    def _is_repeated(self, asked: OpenRequest, found: Candidate) -> bool:
        """Return True if a frame that could be both arrived too late for a response."""
        spoiled = asked.spoiled
        if spoiled is not None and found.began - spoiled.ended > GLUED:
            return True  # the damaged bytes were the response
        return found.began - asked.ended > self._times.limit(asked.frame.unit)

    def _is_late_echo(self, found: Candidate) -> bool:
        """Return True for the response to an earlier request while another one is awaited."""
        asked, late = self.pairing.due, self.pairing.given_up(found.frame.unit)
        if asked is None or asked.spoiled is not None or not _fits(late, found):
            return False
        return found.began - asked.ended <= self._times.limit(asked.frame.unit)

    def _was_a_response(self, asked: OpenRequest, at: float) -> bool:
        """
        Return True if the open request was in fact a response, judged by the time of the next
        request.

        That is likely if it could be a response, and nothing answered it: it arrived twice, or its
        request was damaged, because clients wait for their responses.
        """
        is_open = asked.spoiled is None and not self._is_certain
        return is_open and at - asked.ended <= self._times.limit(asked.frame.unit)

    # --- both -----------------------------------------------------------------------------

    def _take_request(self, found: Candidate) -> None:
        before = self.pairing.due
        if before is not None and self._was_a_response(before, found.began):
            self._held = self._held and self._held._replace(part="response")
            self.pairing.withdraw(before)
        elif before is not None:
            # Times are not learned from guesses, because they decide the next guess.
            if before.spoiled is None and self._is_certain and not found.may_answer:
                self._times.note_next_request(found.began - before.ended)
            self._note(None)
        heard = Heard(found.began, found.ended, "request", found.frame)
        self._note(None if found.may_answer else heard)
        self._held = heard if found.may_answer else None
        self._is_certain = not found.may_answer
        self.pairing.ask(found.began, found.ended, found.frame)
        self._release()

    def _take_response(self, found: Candidate) -> None:
        asked = self.pairing.due
        outcome = self.pairing.answer(found.began, found.ended, found.frame)
        if asked is not None and outcome is not None and outcome.kind != "invalid":
            self._times.note_answer(found.frame.unit, max(found.began - asked.ended, 0.0))


def _fits(asked: OpenRequest | None, found: Candidate) -> bool:
    if asked is None or asked.frame.unit != found.frame.unit:
        return False
    return answered(asked.request, found.frame.pdu).kind != "invalid"


def _has_function(found: Candidate) -> bool:
    """Return True if the function code is valid (application protocol, 4.1)."""
    code = found.frame.pdu[0]
    return 0 < code < 0x80 or (code > 0x80 and found.may_answer)


# --- transactions ---------------------------------------------------------------------------------


LineFraming = Literal["rtu", "ascii"]

# The sender of bytes, if it is known.
Direction = Literal["client", "server"]


# The longest gap inside a frame, in seconds: that of ASCII (serial line, 2.5.2.1), which is longer
# than that of RTU.
LONGEST_GAP = 1.0


class Separator:
    """
    Separates the bytes on a line into requests, responses and damage, and pairs them.

    Args:
        framing: "rtu" or "ascii".
        on_heard: called with a `Heard` for each frame as soon as it is known to be a request or a
            response, and for damaged bytes.
        pause: the seconds between two frames on an RTU line, as `pause_between_frames` returns;
            0 if bytes do not arrive at the pace of a serial line.

    Attributes:
        quiet: seconds without a byte after which `tick` should be called.

    Raises:
        ValueError: `framing` is wrong.
        TypeError: `on_heard` is not a function.
    """

    def __init__(
        self,
        framing: LineFraming,
        on_heard: OnHeard = lambda heard: None,
        pause: float = 0.0,
    ) -> None:
        if framing not in ("rtu", "ascii"):
            raise ValueError(f'framing must be "rtu" or "ascii", not {framing!r}')
        checked_callback("on_heard", on_heard)
        self._framing = framing
        self._pause = pause
        self._naming = _Naming(on_heard)
        self._hearings: dict[Direction | None, _Hearing] = {}
        self._ascii: list[AsciiFramer] = []
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
            found = self._hearing(direction).hear(data, at)
            self._take(found)
        return self._given()

    def tick(self, at: float) -> list[Transaction]:
        """Note that no more bytes arrived until this time; otherwise like `feed`."""
        self._wait(at)
        self._naming.tick(at)
        return self._given()

    def end(self) -> list[Transaction]:
        """Note that no more bytes will arrive; otherwise like `feed`."""
        for hearing in self._hearings.values():
            self._take(hearing.silence(is_long=True))
        self._last.clear()
        self._naming.end()
        return self._given()

    def take(self, found: Candidate | Damage) -> list[Transaction]:
        """Take a frame or damaged bytes that were separated before; otherwise like `feed`."""
        self._naming.take(found)
        return self._given()

    def _wait(self, at: float) -> None:
        for direction, last in list(self._last.items()):
            hearing = self._hearing(direction)
            is_long = at - last >= LONGEST_GAP
            if is_long or (at - last >= hearing.quiet and direction not in self._is_quiet):
                self._is_quiet.add(direction)
                self._take(hearing.silence(is_long=is_long))
            if is_long:
                del self._last[direction]

    def _take(self, found: Iterator[Candidate | Damage]) -> None:
        for each in found:
            self._naming.take(each)

    def _given(self) -> list[Transaction]:
        done, self._naming.pairing.done = self._naming.pairing.done, []
        for each in done:
            self._follow_delimiter(each)
        return done

    def _hearing(self, direction: Direction | None) -> _Hearing:
        if direction not in self._hearings:
            self._hearings[direction] = self._made(direction)
        return self._hearings[direction]

    def _made(self, direction: Direction | None) -> _Hearing:
        is_asking = None if direction is None else direction == "client"
        if self._framing == "ascii":
            framer = AsciiFramer()
            self._ascii.append(framer)
            return _FramerHearing(lambda: framer, is_asking)
        if is_asking is None:
            return _RtuHearing(self._pause)
        role: Direction = "server" if is_asking else "client"
        return _FramerHearing(lambda: RtuFramer(role, self._pause), is_asking)

    def _follow_delimiter(self, done: Transaction) -> None:
        if self._ascii and isinstance(done.request, Diagnostics) and done.kind == "answered":
            for framer in self._ascii:
                framer.delimiter = delimiter_after(done.request.encode(), framer.delimiter)
