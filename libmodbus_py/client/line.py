"""
Which answer belongs to which request on a line, where frames have no transaction ids.

One request is in flight at a time. A frame shows its unit and its function, but not which request
it answers: a unit that answers late, or twice, could shift all values by one request. So a line
follows this table. "It" is the unit together with the function of a request; DOUBT is a state of
this pair, and the other states are those of the line.

    state   event                                  what follows
    -----   -----                                  ------------
    IDLE    a request                              ASKED; if it is in DOUBT, once its unit has been
                                                   silent, or has not for one timeout
    ASKED   its answer                             IDLE, and the answer is the result
    ASKED   its answer, if it is in DOUBT, is the  HOLD
            first since the line was opened, took
            unusually long or short, or is due to
            be checked; where a frame came
            without a request, also one equal to
            the last one to another request
    ASKED   a damaged answer, one that does not    IDLE and DOUBT; the request fails
            fit, the end of its time
    ASKED   its caller is gone                     IDLE and DOUBT
    any     a frame that is no answer to it        it is dropped and counted; DOUBT of the unit and
                                                   function of the frame; the wait goes on
    HOLD    the same answer again, or a late       HOLD, from the beginning
            frame of its unit
    HOLD    another frame of it, or a damaged one  IDLE and DOUBT; the request fails
            that is longer than noise
    HOLD    nothing for twice the time of its      IDLE, no DOUBT; the answer is the result
            slowest good answer of this length
    HOLD    the end of its time comes first        IDLE, and the answer is the result: without
                                                   DOUBT, or if the request itself led to it and
                                                   is repeated; else the request fails. DOUBT ends
                                                   if silence follows
    HOLD    the other side ends the connection     the same
    DOUBT   a late frame of its unit; while IDLE,  the silence counts anew
            bytes that may be the beginning of one
    DOUBT   ten timeouts of silence                no DOUBT

Why: a late answer comes before the answer that follows it, so a second frame within HOLD tells that
the first one was late or doubled. Silence lets late answers pass before the next request. A late
frame of another function shows that the unit still works through earlier requests. If all answers
are those to the requests before, one of them came too soon, so it is held. Other functions of the
unit need not wait, because no late answer fits them. `./run explore` walks through every sequence
of events that this table can meet; what it cannot tell apart is named in `EXCEPTIONS` there. The
history of a line outlives its clients (`history`).

The silence lasts twice the time of the slowest answer that the unit ever gave, one timeout if it
gave none. An answer is due to be checked after DOUBT, after a late frame of its unit and after one
that took unusually long or short; then after twice as long each time, and at least once in ten
timeouts. The time of an answer that was held in DOUBT does not show how fast its unit is. On a line
without a history, the first answer is held until the line has been open for 60 ms.

A line keeps the order of requests to a unit: those behind one that waits wait, too
(`Transactions`).
"""

from __future__ import annotations

import math
from typing import Any
from weakref import WeakKeyDictionary

from ..ports.endpoint import Endpoint
from ..ports.port import Silence
from ..ports.trace import Trace
from ..protocol.checks import log_warning
from ..protocol.echo import Echo
from ..protocol.errors import (
    MAX_RECEIVED,
    ExceptionResponse,
    FrameError,
    InvalidResponse,
    ModbusError,
)
from ..protocol.framing import (
    LINE_FEED,
    AsciiFramer,
    Frame,
    Framer,
    RtuFramer,
    delimiter_after,
    make_framer,
)
from ..protocol.pdu.request import Request
from ..protocol.rtu import MAX_NOISE, has_own_length
from .call import Call, Matching, no_answer
from .history import TIMES_SLOWEST, Pair, history_of
from .statistics import Statistics

__all__ = ["Line"]

# An answer is put on HOLD at least once in so many timeouts, and their silence ends DOUBT.
TIMEOUTS_BETWEEN_CHECKS = 10

# For so many seconds after a line was opened of which nothing is known, answers are on HOLD.
OPENED_S = 0.06


class Line(Matching):
    """The request in flight on one line, and the states of the table above."""

    def __init__(
        self,
        endpoint: Endpoint,
        statistics: Statistics,
        trace: Trace,
        silence: Silence,
        delimiter: int = LINE_FEED,
        *,
        any_unit: bool = False,
    ) -> None:
        super().__init__(statistics, trace)
        self._any_unit = any_unit
        self._endpoint = endpoint
        self._silence = silence
        self._delimiter = delimiter
        self._echo = Echo(endpoint.options.get("echo"))
        self._own: Request[Any] | None = None  # the latest request, if it has its own length rule
        self._framer = self._make_framer()
        self._call: Call | None = None
        self._ended: list[Call] = []
        self._wrong: ModbusError | None = None  # the error of bytes received before the answer
        self._received = bytearray()
        self._heard_at = 0.0  # when bytes came last
        self._quiet_at: float | None = None  # when silence ends a frame
        # In HOLD: the answer, when it came, for how many seconds it is held, and until when.
        self._held: bytes | None = None
        self._held_at = self._held_for = self._held_until = 0.0
        # False if the answer may be that to an earlier request, so that its time is not known.
        self._is_sure = True
        self._history = history_of(endpoint)
        self._opened_at = 0.0
        self._is_opened = False  # the first answer since the line was opened is to come
        self._is_unknown = False  # nothing was known of the line when it was opened
        # When requests are sent that wait for silence.
        self._waits: WeakKeyDictionary[Call, float] = WeakKeyDictionary()

    def _make_framer(self) -> Framer:
        end = self._endpoint
        framer = make_framer(end.framing, "client", end.pause, self._own)
        if isinstance(framer, AsciiFramer):
            framer.delimiter = self._delimiter
        return framer

    # --- asking --------------------------------------------------------------------------

    def ready_at(self, unit: int, function: int | None = None) -> float:
        return max(
            (
                pair.quiet_at
                for code, pair in self._history.pairs_of(unit)
                if pair.is_doubted and function in (None, code)
            ),
            default=0.0,
        )

    def may_start(self, call: Call, now: float) -> bool:
        ready_at = self._silence.over_at
        pair = self._history.units.get(call.unit, {}).get(call.pdu[0])
        if pair is not None and pair.is_doubted and pair.quiet_at > ready_at:
            ready_at = pair.quiet_at
        if ready_at > now:
            until = self._waits.setdefault(call, now + call.timeouts.timeout)
            if until > now:
                self.wake(min(ready_at, until))
                return False
        self._waits.pop(call, None)
        return True

    def start(self, call: Call, now: float) -> bytes:
        request = call.request
        own = request if request is not None and has_own_length(request) else None
        self._own, last = own, self._own
        if self._framer.pending or self._echo.is_holding:
            rest = self._framer.end() + self._echo.forget()
            if self._trace.is_on():
                self._trace.tell("received", rest)
            self._framer = self._make_framer()
        elif own is not last:
            self._framer = self._make_framer()
        adu = self._framer.encode(Frame(call.unit, call.pdu))
        self._received.clear()
        self._quiet_at = self._wrong = self._held = None
        self._is_sure = True
        self.unasked: int = 0
        self._silence.sent(len(adu), now)
        if self._echo.is_there is None:  # if no byte came, no echo will
            self._echo.forget()
        if self._echo.is_there is not False:
            self._echo.sent(adu, is_telling=_is_telling(call.pdu))
        is_unknown = self._is_unknown and now < self._opened_at + call.timeouts.timeout
        pair = self._history.pair(call.unit, call.pdu[0], now, is_unknown=is_unknown)
        # A unit that owes another answer may be stalled: its silence does not show the end.
        if any(other.is_doubted for _, other in self._history.pairs_of(call.unit)):
            silence = TIMEOUTS_BETWEEN_CHECKS * call.timeouts.timeout
        else:
            silence = TIMES_SLOWEST * self._history.slowest_of(call.unit)
        if pair.is_answered or now >= pair.heard_at + silence:
            pair.check(now, now - pair.heard_at)
        if now >= self._opened_at + OPENED_S:
            self._is_opened = False
        if not call.is_silent:
            self._call = call
        return adu

    def _pair(self, call: Call, now: float) -> Pair:
        return self._history.pair(call.unit, call.pdu[0], now)

    def _doubt(self, call: Call, now: float) -> None:
        """Begin to doubt, because the answer to a request may still come."""
        timeout = call.timeouts.timeout
        silence = TIMES_SLOWEST * self._history.slowest_of(call.unit)
        self._pair(call, now).doubt(now, min(timeout, silence or timeout), call)

    # --- bytes ----------------------------------------------------------------------------

    def take(self, data: bytes, now: float) -> list[Call]:
        self._silence.heard(now)
        self._heard_at = now
        self._received += data[: MAX_RECEIVED - len(self._received)]
        if self._call is None:
            self.unasked += len(data)
            self._note_beginnings(self._framer.rest + data, now)
        if (was_there := self._echo.is_there) is not False:
            data = self._echo.without(data)
            if self._echo.is_there and not was_there:
                self._statistics.echoes += 1
                text = "%s: what is sent comes back (local echo), and is dropped; set echo=1"
                log_warning(__name__, text, self._endpoint)
        for frame in self._framer.scan(data):
            self._judge(frame, now)
        call = self._call
        if call is not None and (self._framer.pending or self._wrong or self._echo.is_holding):
            self._quiet_at = now + (self._framer.quiet or 0.0)
            self.wake(self._quiet_at)
            if self._endpoint.framing == "ascii" and not self._framer.pending:
                self._search(call, now)  # the delimiter marks the end of a frame
        calls, self._ended = self._ended, []
        return calls

    def _judge(self, frame: Frame | FrameError, now: float) -> None:
        """Apply the table to one frame, or to bytes that are no frame."""
        call = self._call
        if isinstance(frame, FrameError):
            if self.is_traced:
                self._trace.tell("received", frame.received)
            self._statistics.invalid += 1
            self._wrong = frame
            if self._held is not None and call is not None and self._is_of(call, frame.received):
                answer = self._framer.encode(Frame(call.unit, self._held))
                if len(self._received.rpartition(answer)[2]) > MAX_NOISE:
                    self._fail(call, frame, now)
            return
        unit, pdu, _ = frame
        if self.is_traced:
            self._trace.tell("received", self._framer.encode(frame), unit, pdu[0])
        function = pdu[0] & 0x7F
        if self._any_unit and call is not None:
            unit = call.unit
        if call is None or unit != call.unit or function != call.pdu[0]:
            self._note_other(unit, function, call, now)
        elif pdu == call.pdu and self._echo.is_there and not self._echo.has_returned:
            self._echo.has_returned = True
        elif pdu == call.pdu and _is_telling(pdu):
            self._wrong = InvalidResponse("the request itself came back; echo=True?")
        elif pdu == call.pdu and self._echo.is_there is None and function in _LIKE_ANSWERS:
            text = "an answer that is equal to its request may be an echo; echo=True or False?"
            self._wrong = InvalidResponse(text)
        elif self._held is None:
            self._take_answer(call, pdu, now)
        else:
            self._note_late(unit, call, now)
            pair = self._pair(call, now)
            pair.is_repeating |= not pair.is_doubted
            if pdu != self._held:
                error = InvalidResponse("two answers came, one to an earlier request")
                self._fail(call, error, now)

    def _take_answer(self, call: Call, pdu: bytes, now: float) -> None:
        pair, took = self._pair(call, now), now - call.sent_at
        longest = TIMES_SLOWEST * (self._history.slowest_of(call.unit) or math.inf)
        is_unusual = took > longest or pair.is_too_fast(len(pdu), took)
        if is_unusual:
            pair.interval = 0.0  # the next answer is checked: its time may end before HOLD
        if (
            pair.is_doubted
            or self._is_opened
            or is_unusual
            or pair.is_of_another(call.pdu, pdu)
            or pair.is_due(now, TIMEOUTS_BETWEEN_CHECKS * call.timeouts.timeout)
        ):
            self._hold(call, pdu, now)
        else:
            self._believe(call, pdu, now, now)

    def _hold(self, call: Call, pdu: bytes, now: float) -> None:
        pair = self._pair(call, now)
        self._held, self._held_at = pdu, now
        self._is_sure = not pair.is_doubted
        self._held_for = pair.hold_of(len(pdu), now - call.sent_at)
        if self._is_opened and self._is_unknown:
            self._held_for = max(self._held_for, self._opened_at + OPENED_S - now)
        call.hold()
        self._begin_hold(call, now)

    def _begin_hold(self, call: Call, now: float) -> None:
        self._held_until = now + self._held_for
        self.wake(min(self._held_until, call.deadline))

    def _believe(self, call: Call, pdu: bytes, came_at: float, now: float) -> None:
        """Accept an answer, and remember it."""
        pair = self._pair(call, now)
        pair.note_answer(call.pdu, pdu)
        pair.note_time(len(pdu), came_at - call.sent_at, is_sure=self._is_sure)
        pair.heard_at = now
        self._is_opened = False
        self.unanswered: int = 0
        call.answer(pdu)
        self._end(call)

    def _fail(self, call: Call, error: ModbusError, now: float) -> None:
        error.received = bytes(self._received)
        call.answer(error)
        self._doubt(call, now)
        self._end(call)

    def _end(self, call: Call) -> None:
        self._call = self._held = None
        self._ended.append(call)

    def _note_other(self, unit: int, function: int, call: Call | None, now: float) -> None:
        """Note a frame that answers no request in flight (serial line, 2.4.1)."""
        pair = self._history.pair(unit, function, now)
        if not pair.is_doubted:
            pair.is_repeating = True
            pair.doubt(now, TIMES_SLOWEST * self._history.slowest_of(unit))
        self._note_late(unit, call, now)
        if call is not None:
            what = f"function {function} was answered, not {call.pdu[0]}"
            self._wrong = InvalidResponse(what if unit == call.unit else f"unit {unit} answered")
            self._wrong.answers_another = True

    def _note_late(self, unit: int, call: Call | None, now: float) -> None:
        """Note a late answer: its unit may still work through other requests."""
        self._statistics.late_answers += 1
        for _, pair in self._history.pairs_of(unit):
            pair.interval = 0.0
            if pair.is_doubted:
                pair.heard(now)
        if call is not None and call.unit == unit and self._held is not None:
            self._begin_hold(call, now)

    def _note_beginnings(self, data: bytes | bytearray, now: float) -> None:
        """Note bytes that may be the beginning of a late answer."""
        for unit in list(self._history.units):
            for function, pair in self._history.pairs_of(unit):
                for start in self._starts(unit, function) if pair.is_doubted else ():
                    lengths = range(1, len(start))
                    if start in data or any(data.endswith(start[:size]) for size in lengths):
                        pair.heard(now)

    def _starts(self, unit: int, function: int) -> list[bytes]:
        """Return how the answers of a unit to a function begin."""
        starts = [bytes([unit, function | bit]) for bit in (0, 0x80)]
        if self._endpoint.framing == "ascii":
            starts = [b":%02X%02X" % (start[0], start[1]) for start in starts]
        return starts

    def _is_of(self, call: Call, data: bytes) -> bool:
        """Return True if a damaged answer to a request may be in the data, beside its echo."""
        rest = data.upper() if self._endpoint.framing == "ascii" else data
        rest = rest.replace(call.adu, b"", 1)
        return any(start in rest for start in self._starts(call.unit, call.pdu[0]))

    def _search(self, call: Call, now: float, *, is_over: bool = False) -> None:
        """
        Look for the answer between noise; end the wait for one that is damaged. After mere noise,
        an answer may still follow.
        """
        # The bytes before an answer on HOLD are judged.
        data = bytes(self._received if self._held is None else self._framer.rest)
        if isinstance(self._framer, RtuFramer):
            answer = data.replace(call.adu, b"", 1) if self._echo.is_there else data
            pdu = self._framer.find_response(answer, call.unit, call.pdu[0], is_over=is_over)
            if pdu:
                self._framer = self._make_framer()
                self._judge(Frame(call.unit, pdu), self._heard_at)
            if pdu is not None:
                return
        wrong = self._wrong
        if isinstance(wrong, FrameError) and self._held is None and self._is_of(call, data):
            self._fail(call, wrong, now)

    def has_begun(self) -> bool:
        return bool(self._received)

    def received_with(self, call: Call, pdu: bytes) -> bytes:
        return bytes(self._received)

    # --- no answer ------------------------------------------------------------------------

    def expire(self, now: float) -> list[Call]:
        self._end_frame(now)
        if (call := self._call) is not None and call.deadline <= now:
            self._search(call, now, is_over=True)
        call, answer = self._call, self._held
        if call is None:
            pass
        elif answer is not None and self._held_until <= now:
            self._pair(call, now).check(now, now - call.sent_at)
            self._believe(call, answer, self._held_at, now)
        elif call.deadline > now:
            self.wake(call.deadline if answer is None else min(self._held_until, call.deadline))
        else:
            pair = self._pair(call, now)
            if not self._end_hold(call, now):
                error = self._wrong or no_answer(
                    call.timeouts.timeout, bytes(self._received), is_held=answer is not None
                )
                self._statistics.timeouts += 1
                self.unanswered += answer is None
                self._fail(call, error, now)
            if pair.is_doubted:
                pair.heard(now)
                pair.is_answered = answer is not None
        calls, self._ended = self._ended, []
        return calls

    def _end_hold(self, call: Call, now: float) -> bool:
        """Take the answer on HOLD, because no other one comes in time, if that is not doubted."""
        pair = self._pair(call, now)
        if self._held is None or (pair.is_doubted and pair.owed is not call):
            return False
        self._believe(call, self._held, self._held_at, now)
        return True

    def end(self, now: float) -> list[Call]:
        if self._call is not None and len(self._framer.rest) <= MAX_NOISE:
            self._end_hold(self._call, now)
        calls, self._ended = self._ended, []
        return calls

    def _end_frame(self, now: float) -> None:
        """Judge the bytes before a silence."""
        if self._quiet_at is None or self._call is None:
            return
        if self._quiet_at > now:
            self.wake(self._quiet_at)
            return
        self._quiet_at = None
        for frame in [*self._framer.scan(self._echo.release()), *self._framer.scan_silence()]:
            self._judge(frame, now)
        if self._call is not None:
            self._search(self._call, now)

    def conclude(self, call: Call, error: Exception | None, now: float) -> None:
        if error is None:
            delimiter = delimiter_after(call.pdu, self._delimiter)
            if delimiter != self._delimiter and self._endpoint.framing == "ascii":
                self._delimiter = delimiter
                self._framer = self._make_framer()
        elif isinstance(call.reply, bytes) and not isinstance(error, ExceptionResponse):
            self._doubt(call, now)

    def withdraw(self, call: Call, now: float) -> bool:
        if self._call is not call:
            return False
        self._call = self._held = None
        self._doubt(call, now)
        return True

    def reset(self, now: float) -> list[Call]:
        # Doubts remain: the units are not on this side of the connection.
        call, self._call = self._call, None
        answer, self._held = self._held, None
        self._ended.clear()  # left by a Ctrl-C
        self._framer = self._make_framer()
        self._begin_again(self.rest)
        self._echo.reset()
        if call is not None:
            self._doubt(call, now)
            self._pair(call, now).is_answered = answer is not None
        self._history = history_of(self._endpoint)
        self._is_unknown = not self._history.units
        self._opened_at, self._is_opened = now, True
        return [] if call is None else [call]


# A frame that is equal to the request may be an echo: a possible answer to reads, because it has
# the same length; to writes of several cells, what some devices answer.
_LIKE_ANSWERS = frozenset([0x01, 0x02, 0x0F, 0x10, 0x17])


def _is_telling(pdu: bytes) -> bool:
    """
    Return True if the frame of a request cannot be an answer: such a one is an echo.

    The answer to a read has the number of its bytes where the request has its address. Some devices
    answer a write of several cells with the whole request.
    """
    return pdu[0] in (1, 2, 3, 4, 23) and pdu[1] != len(pdu) - 2
