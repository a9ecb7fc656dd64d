"""
Which answer belongs to which request on a line, where frames have no transaction ids.

One request is in flight at a time. A frame shows its unit and its function, but not which request
it answers: a unit that answers late, or twice, could shift all values by one request. So a line
follows this table. "It" is the unit together with the function of a request; DOUBT is a state of
this pair, and the other states are those of the line.

    state   event                                  what follows
    -----   -----                                  ------------
    IDLE    a request                              ASKED, once it has been silent for one timeout
                                                   if it is in DOUBT
    ASKED   its answer                             IDLE, and the answer is the result
    ASKED   its answer, while it is in DOUBT;      HOLD
            or an answer equal to one of the last
            three different ones to another request
            of the unit, not to its own last one
    ASKED   a damaged answer, one that does not    IDLE and DOUBT; the request fails
            fit, the end of its time
    ASKED   its caller is gone                     IDLE and DOUBT
    any     a frame that is no answer to it        it is dropped and counted; the wait goes on
    HOLD    the same answer again, or a late       HOLD, from the beginning
            frame of its unit
    HOLD    another frame of it, or a damaged one  IDLE and DOUBT; the request fails
    HOLD    nothing for twice the time of its      IDLE, no DOUBT; the answer is the result
            slowest good answer of this length
    HOLD    the end of its time comes first        IDLE, and the answer is the result: without
                                                   DOUBT, or if the request itself led to it and
                                                   is repeated; else the request fails. DOUBT ends
                                                   if one timeout of silence follows
    DOUBT   a late frame of its unit; any bytes    the silence counts anew
            while IDLE
    DOUBT   ten timeouts of silence; two if it     no DOUBT
            has never answered

Why: a late answer comes before the answer that follows it, so a second frame within HOLD tells that
the first one was late or doubled. Silence lets late answers pass before the next request. A late
frame of another function shows that the unit still works through earlier requests. An answer that
comes twice is found by its equality with an earlier one. Other functions of the unit need not wait,
because no late answer fits them. `./run explore` walks through every sequence of events that
this table can meet; what it cannot tell apart is named in `EXCEPTIONS` there.

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
from ..protocol.framing import LINE_FEED, AsciiFramer, Frame, Framer, delimiter_after, make_framer
from ..protocol.pdu.request import Request
from ..protocol.rtu import find_response, has_own_length
from .answers import Answers
from .call import Call, Matching, no_answer
from .statistics import Statistics

__all__ = ["Line"]

# HOLD lasts this multiple of the time of the slowest good answer.
TIMES_SLOWEST = 2

# A request waits for silence for so many timeouts, and then fails. So much silence ends the DOUBT
# of what has never answered.
TIMEOUTS_OF_SILENCE = 2

# An answer is put on HOLD at least once in so many timeouts, and their silence ends DOUBT.
TIMEOUTS_BETWEEN_CHECKS = 10


class Pair:
    """The states of a unit and a function."""

    quiet_at: float = 0.0  # in DOUBT, when it has been silent for `timeout`
    timeout: float = 0.0
    owed: Call | None = None  # whose answer may still come; None if there may be others
    is_known: bool = False  # True if it has been answered
    is_doubted: bool = False
    # True if the last request was answered, but the time for HOLD was too short.
    is_answered: bool = False
    # True if the last answers may be those to the requests before; else known at `checked_at`.
    is_shifted: bool = False

    def __init__(self, now: float) -> None:
        self.heard_at: float = now  # when a frame of it came last
        self.checked_at: float = now

    def doubt(self, now: float, timeout: float, owed: Call | None = None) -> None:
        """Begin to doubt, or doubt more."""
        self.owed = owed if not self.is_doubted or owed is self.owed else None
        self.is_doubted = True
        self.timeout = timeout
        self.heard(now)

    def heard(self, now: float) -> None:
        """Count the silence anew."""
        self.is_answered = False
        self.quiet_at = now + self.timeout

    def check(self, now: float) -> None:
        """Note that no other answer follows the last one."""
        self.is_doubted = self.is_answered = self.is_shifted = False
        self.checked_at = now


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
        self._quiet_at: float | None = None  # when silence ends a frame
        # In HOLD: the answer, when it came, and until when it is held.
        self._held: bytes | None = None
        self._held_at = self._held_until = 0.0
        self._pairs: dict[tuple[int, int], Pair] = {}
        self._answers = Answers()
        # When requests that wait for silence fail.
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
                for (other, code), pair in self._pairs.items()
                if pair.is_doubted and other == unit and function in (None, code)
            ),
            default=0.0,
        )

    def may_start(self, call: Call, now: float) -> bool:
        ready_at = self._silence.over_at
        pair = self._pairs.get((call.unit, call.pdu[0]))
        if pair is not None and pair.is_doubted and pair.quiet_at > ready_at:
            ready_at = pair.quiet_at
        if ready_at <= now:
            self._waits.pop(call, None)
            return True
        until = now + TIMEOUTS_OF_SILENCE * call.timeouts.timeout
        self.wake(min(ready_at, self._waits.setdefault(call, until)))
        return False

    def is_overdue(self, call: Call, now: float) -> bool:
        return self._waits.get(call, math.inf) <= now and not self.may_start(call, now)

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
        self.unasked: int = 0
        self._silence.sent(len(adu), now)
        if self._echo.is_there is not False:
            self._echo.sent(adu, is_telling=_is_telling(call.pdu))
        pair = self._pair(call, now)
        was_quiet = now >= pair.heard_at + TIMES_SLOWEST * self._answers.slowest
        timeouts = TIMEOUTS_BETWEEN_CHECKS if pair.is_known else TIMEOUTS_OF_SILENCE
        was_silent = pair.is_doubted and now >= pair.quiet_at + (timeouts - 1) * pair.timeout
        if pair.is_answered or was_silent or (was_quiet and not pair.is_doubted):
            pair.check(now)
        if not call.is_silent:
            self._call = call
        return adu

    def _pair(self, call: Call, now: float) -> Pair:
        key = call.unit, call.pdu[0]
        pair = self._pairs.get(key)
        if pair is None:
            pair = self._pairs[key] = Pair(now)
        return pair

    # --- bytes ----------------------------------------------------------------------------

    def take(self, data: bytes, now: float) -> list[Call]:
        self._silence.heard(now)
        self._received += data[: MAX_RECEIVED - len(self._received)]
        if self._call is None:
            self.unasked += len(data)
            for pair in self._pairs.values():
                if pair.is_doubted:
                    pair.heard(now)
        if (was_there := self._echo.is_there) is not False:
            data = self._echo.without(data)
            if self._echo.is_there and not was_there:
                self._statistics.echoes += 1
                text = "%s: what is sent comes back (local echo), and is dropped; set echo=1"
                log_warning(__name__, text, self._endpoint)
        for found in self._framer.scan(data):
            self._judge(found, now)
        call = self._call
        if call is not None and (self._framer.pending or self._wrong or self._echo.is_holding):
            self._quiet_at = now + (self._framer.quiet or 0.0)
            self.wake(self._quiet_at)
            if self._endpoint.framing == "ascii" and not self._framer.pending:
                self._search(call, now)  # the end of a frame is marked: no more of it comes
        ended, self._ended = self._ended, []
        return ended

    def _judge(self, found: Frame | FrameError, now: float) -> None:
        """Follow the table for one frame, or for bytes that are none."""
        call = self._call
        if isinstance(found, FrameError):
            if self.is_traced:
                self._trace.tell("received", found.received)
            self._statistics.invalid += 1
            self._wrong = found
            if self._held is not None and call is not None:
                self._fail(call, found, now)
            return
        unit, pdu, _ = found
        if self.is_traced:
            self._trace.tell("received", self._framer.encode(found), unit, pdu[0])
        function = pdu[0] & 0x7F
        if self._any_unit and call is not None:
            unit = call.unit
        if call is None or unit != call.unit or function != call.pdu[0]:
            self._note_other(unit, function, call, now)
        elif pdu == call.pdu and self._echo.is_there and not self._echo.has_returned:
            self._echo.has_returned = True
        elif pdu == call.pdu and self._echo.is_there is None and function in _LIKE_ANSWERS:
            text = "an answer that is equal to its request may be an echo; echo=True or False?"
            self._wrong = InvalidResponse(text)
        elif self._held is None:
            self._take_answer(call, pdu, now)
        else:
            self._note_late(unit, call, now)
            if pdu == self._held:
                self._hold(call, pdu, now)
            else:
                error = InvalidResponse("two answers came, one to an earlier request")
                self._fail(call, error, now)

    def _take_answer(self, call: Call, pdu: bytes, now: float) -> None:
        pair, answers = self._pair(call, now), self._answers
        if (
            pair.is_doubted
            or (pair.is_shifted and not answers.is_to_latest(call.unit, call.pdu))
            or now > pair.checked_at + TIMEOUTS_BETWEEN_CHECKS * call.timeouts.timeout
            or answers.is_of_another(call.unit, call.pdu, pdu)
        ):
            self._hold(call, pdu, now)
        else:
            pair.is_shifted |= answers.is_latest(call.unit, call.pdu, pdu)
            self._believe(call, pdu, now, now)

    def _hold(self, call: Call, pdu: bytes, now: float) -> None:
        self._held, self._held_at = pdu, now
        call.hold()
        self._begin_hold(call, pdu, now)

    def _begin_hold(self, call: Call, pdu: bytes, now: float) -> None:
        slowest = self._answers.slowest_like(call.unit, pdu)
        longest = call.timeouts.timeout if slowest is None else TIMES_SLOWEST * slowest
        self._held_until = now + longest
        self.wake(min(self._held_until, call.deadline))

    def _believe(self, call: Call, pdu: bytes, came_at: float, now: float) -> None:
        """Take an answer, and remember it."""
        self._answers.add(call.unit, call.pdu, pdu)
        self._note_time(call, pdu, came_at, now)
        self.unanswered: int = 0
        call.answer(pdu)
        self._end(call)

    def _note_time(self, call: Call, pdu: bytes, came_at: float, now: float) -> None:
        self._answers.note_time(call.unit, pdu, came_at - call.sent_at)
        pair = self._pair(call, now)
        pair.is_known, pair.heard_at = True, now

    def _fail(self, call: Call, error: ModbusError, now: float) -> None:
        error.received = bytes(self._received)
        call.answer(error)
        self._pair(call, now).doubt(now, call.timeouts.timeout, call)
        self._end(call)

    def _end(self, call: Call) -> None:
        self._call = self._held = None
        self._ended.append(call)

    def _note_other(self, unit: int, function: int, call: Call | None, now: float) -> None:
        """Note a frame that answers no request in flight (serial line, 2.4.1)."""
        pair = self._pairs.get((unit, function))
        if pair is None:
            self._statistics.late_answers += 1
        else:
            pair.heard_at = now
            self._note_late(unit, call, now)
        if call is not None:
            what = f"function {function} was answered, not {call.pdu[0]}"
            self._wrong = InvalidResponse(what if unit == call.unit else f"unit {unit} answered")
            self._wrong.answers_another = True

    def _note_late(self, unit: int, call: Call | None, now: float) -> None:
        """Note a late answer: its unit may still work through other requests."""
        self._statistics.late_answers += 1
        for (other, _), pair in self._pairs.items():
            if other == unit and pair.is_doubted:
                pair.heard(now)
        if call is not None and call.unit == unit and self._held is not None:
            self._begin_hold(call, self._held, now)

    def _search(self, call: Call, now: float, *, is_over: bool = False) -> None:
        """
        Look for the answer between noise; end the wait for one that is damaged. After mere noise,
        an answer may still follow.
        """
        if self._held is not None:
            return
        data = bytes(self._received)
        if self._endpoint.framing == "rtu":
            heard = data.replace(call.adu, b"", 1) if self._echo.is_there else data
            pdu = find_response(heard, call.unit, call.pdu[0], is_over=is_over)
            if pdu:
                self._framer = self._make_framer()
                self._judge(Frame(call.unit, pdu), now)
            if pdu is not None:
                return
        starts, rest = [bytes([call.unit, call.pdu[0] | bit]) for bit in (0, 0x80)], data
        if self._endpoint.framing == "ascii":
            starts, rest = [b":%02X%02X" % (each[0], each[1]) for each in starts], data.upper()
        is_damaged = any(each in rest.replace(call.adu, b"", 1) for each in starts)
        if isinstance(self._wrong, FrameError) and is_damaged:
            self._fail(call, self._wrong, now)

    def has_begun(self) -> bool:
        return bool(self._received)

    def received_with(self, call: Call, pdu: bytes) -> bytes:
        return bytes(self._received)

    # --- no answer ------------------------------------------------------------------------

    def expire(self, now: float) -> list[Call]:
        self._end_frame(now)
        if (call := self._call) is not None and call.deadline <= now:
            self._search(call, now, is_over=True)
        call, held = self._call, self._held
        if call is None:
            pass
        elif held is not None and self._held_until <= now:
            self._pair(call, now).check(now)
            self._believe(call, held, self._held_at, now)
        elif call.deadline > now:
            self.wake(call.deadline if held is None else min(self._held_until, call.deadline))
        else:
            pair = self._pair(call, now)
            if held is not None and (not pair.is_doubted or pair.owed is call):
                self._believe(call, held, self._held_at, now)
            else:
                error = self._wrong or no_answer(
                    call.timeouts.timeout, bytes(self._received), is_held=held is not None
                )
                self._statistics.timeouts += 1
                self.unanswered += held is None
                self._fail(call, error, now)
                if held is not None:
                    self._note_time(call, held, self._held_at, now)
            if pair.is_doubted:
                pair.heard(now)
                pair.is_answered = held is not None
        ended, self._ended = self._ended, []
        return ended

    def _end_frame(self, now: float) -> None:
        """Judge the bytes before a silence."""
        if self._quiet_at is None or self._call is None:
            return
        if self._quiet_at > now:
            self.wake(self._quiet_at)
            return
        self._quiet_at = None
        for found in [*self._framer.scan(self._echo.release()), *self._framer.scan_silence()]:
            self._judge(found, now)
        if self._call is not None:
            self._search(self._call, now)

    def conclude(self, call: Call, error: Exception | None, now: float) -> None:
        if error is None:
            delimiter = delimiter_after(call.pdu, self._delimiter)
            if delimiter != self._delimiter and self._endpoint.framing == "ascii":
                self._delimiter = delimiter
                self._framer = self._make_framer()
        elif isinstance(call.reply, bytes) and not isinstance(error, ExceptionResponse):
            self._pair(call, now).doubt(now, call.timeouts.timeout, call)

    def withdraw(self, call: Call, now: float) -> bool:
        if self._call is not call:
            return False
        self._call = self._held = None
        self._pair(call, now).doubt(now, call.timeouts.timeout, call)
        return True

    def reset(self, now: float) -> list[Call]:
        # Doubts remain: the units are not on this side of the connection.
        call, self._call = self._call, None
        self._ended.clear()  # left by a Ctrl-C
        self._framer = self._make_framer()
        self._begin_again(self.rest)
        self._echo.reset()
        self._held = None
        if call is None:
            return []
        self._pair(call, now).doubt(now, call.timeouts.timeout, call)
        return [call]


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
