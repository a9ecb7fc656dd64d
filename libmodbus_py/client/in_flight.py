"""
Matching by transaction ids, with many requests in flight: Modbus/TCP, and UDP.
"""

from __future__ import annotations

import copy

from ..ports.endpoint import Endpoint
from ..ports.trace import Trace
from ..protocol.errors import FrameError, InvalidResponse, ModbusError
from ..protocol.framing import Frame, Framer, make_framer, mbap
from .batch import Batch, Pending
from .matching import MAX_KEPT, Matching, Replies, no_answer
from .statistics import Statistics

__all__ = ["InFlight"]

# The most ids that are kept for late answers; requests need the others.
MAX_ABANDONED = 0x8000


class InFlight(Matching):
    """
    Matching by transaction ids. An id is used again after all others, and not while a late answer
    with it may arrive.

    Args:
        limit: the number of requests that may be in flight.
        any_unit: True to accept answers from other units than that of the request, because some
            devices always answer as unit 255.
    """

    has_ids = True

    def __init__(
        self,
        endpoint: Endpoint,
        statistics: Statistics,
        trace: Trace,
        *,
        limit: int,
        any_unit: bool = False,
    ) -> None:
        super().__init__(endpoint, statistics, trace)
        self._limit = limit
        self._any_unit = any_unit
        self._last = 0
        self._pending: dict[int, Pending] = {}
        self._abandoned: dict[int, None] = {}
        self._strays = b""
        # Id -> the error of a wrong frame with this id; the right answer may still follow.
        self._wrong: dict[int, FrameError] = {}
        # Id -> the unit that answered, with `any_unit`.
        self._units: dict[int, int] = {}

    def _make_framer(self) -> Framer:
        return make_framer(self._framing, "client")

    def next_number(self) -> int:
        """Return an id that belongs to no request in flight, and to no late answer."""
        number = self._last + 1 & 0xFFFF
        while number in self._pending or number in self._abandoned:
            number = number + 1 & 0xFFFF
        self._last = number
        return number

    def owes(self, pending: Pending) -> bool:
        return _number(pending.adu) in self._abandoned

    def start(self, batch: Batch, index: int, now: float, adu: bytes | None = None) -> Pending:
        if not self._pending:
            self._strays = b""
            self._wrong.clear()
            self._units.clear()
        if adu is None:
            number = self.next_number()
            adu = mbap(number, batch.unit, batch.pdus[index])
        else:
            number = _number(adu)
        self.unasked = 0
        pending = Pending(batch, index, adu, now)
        if not (batch.silent and batch.silent[index]):
            self._pending[number] = pending
        return pending

    # --- answers --------------------------------------------------------------------------

    def take(self, data: bytes, now: float) -> Replies:
        if not self._pending:
            self.unasked += len(data)
        replies: Replies = []
        is_traced = self._trace.is_on()
        for each in self._framer.scan(data):
            if isinstance(each, FrameError):
                self._blame(each, replies)
                continue
            unit, pdu, number = each
            if is_traced:
                self._trace.tell("received", self._framer.encode(each), unit, pdu[0])
            pending = self._pending.pop(number, None)
            if pending is None:
                self._drop(each, now)
            elif pending.batch.unit == unit or self._any_unit:
                self.unanswered = 0
                self.answered_at = now
                if self._any_unit:
                    self._units[number] = unit
                replies.append((pending, pdu))
            else:
                replies.append((pending, self._other_unit(each)))
        rest = self._framer.pending
        self.rest = (self.rest + data)[-rest:] if rest else b""
        self.is_clean = not (rest or self._abandoned or self.unanswered)
        return replies

    def _drop(self, frame: Frame, now: float) -> None:
        """Drop a frame. Late answers prove that the server is alive; stray frames do not."""
        self._statistics.late_answers += 1
        if frame.transaction in self._abandoned:
            del self._abandoned[frame.transaction]
            self.unanswered = 0
            self.answered_at = now
        else:
            self._keep_stray(self._framer.encode(frame))

    def _keep_stray(self, data: bytes) -> None:
        self._strays += data[: MAX_KEPT - len(self._strays)]

    def _other_unit(self, frame: Frame) -> InvalidResponse:
        self._statistics.invalid += 1
        error = InvalidResponse(
            f'unit {frame.unit} answered; accept_unit="any" would take it',
            received=self._framer.encode(frame),
        )
        error.answers_another = True
        return error

    def _blame(self, error: FrameError, replies: Replies) -> None:
        """
        Assign an error to the request whose answer it should have been.

        All pending requests fail when the stream cannot be understood any more.
        """
        self._statistics.invalid += 1
        if self._trace.is_on():
            self._trace.tell("received", error.received)
        if not self._framer.in_step:
            self.is_in_step = False
            pending, self._pending = self._pending, {}
            replies += [(each, copy.copy(error)) for each in pending.values()]
        elif self._framing == "udp":
            self._keep_stray(error.received)  # the next datagram may be the right one
        elif (number := _number(error.received)) in self._pending:
            self._wrong[number] = error
            if len(self._wrong) > self._limit:
                waited = self._wrong.keys() & self._pending
                self._wrong = {each: self._wrong[each] for each in waited}

    def received_with(self, pending: Pending, pdu: bytes) -> bytes:
        number = _number(pending.adu)
        frame = mbap(number, self._units.get(number, pending.batch.unit), pdu)
        return frame if self._pending else frame + self.rest

    # --- no answer ------------------------------------------------------------------------

    def expire(self, now: float) -> Replies:
        overdue: Replies = []
        for number, pending in list(self._pending.items()):
            if pending.deadline > now:
                self._wake(pending.deadline)
                continue
            self._abandon(number)
            error = self._wrong.get(number) or self._no_answer(pending)
            overdue.append(self._time_out(pending, error))
        return overdue

    def _no_answer(self, pending: Pending) -> ModbusError:
        timeout = pending.batch.timeouts.timeout
        begun = self.rest and _number(self.rest) not in self._pending
        if begun or not self._strays:
            return no_answer(timeout, self.rest if begun else b"")
        error = no_answer(timeout, self._strays)
        number, other = _number(pending.adu), _number(self._strays)
        if number != other:
            error.args = (f"{error.args[0]}: id {other}, not {number}",)
            error.answers_another = True
        return error

    def withdraw(self, batch: Batch, now: float) -> list[Pending]:
        withdrawn = {
            number: pending for number, pending in self._pending.items() if pending.batch is batch
        }
        for number in withdrawn:
            self._abandon(number)
        return list(withdrawn.values())

    def _abandon(self, number: int) -> None:
        del self._pending[number]
        self._abandoned[number] = None
        self.is_clean = False
        if len(self._abandoned) > MAX_ABANDONED:
            del self._abandoned[next(iter(self._abandoned))]

    def reset(self, now: float) -> list[Pending]:
        super().reset(now)
        pending = list(self._pending.values())
        self._pending = {}
        self._abandoned = {}
        self.rest = self._strays = b""
        return pending


def _number(data: bytes) -> int:
    return int.from_bytes(data[:2], "big")
