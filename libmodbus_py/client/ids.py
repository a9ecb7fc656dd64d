"""
Which answer belongs to which request, where frames have transaction ids: Modbus/TCP, TLS and UDP.

An answer belongs to the request with its id. An id is used again after all others, and not while
a late answer with it may arrive; such an answer is dropped and counted. A few bytes that come while
every request has been answered are no part of an answer: they are dropped, as the heartbeats of
some modems.
"""

from __future__ import annotations

import copy
import os
import struct
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

from ..protocol.errors import MAX_RECEIVED, FrameError, InvalidResponse, ModbusError
from ..protocol.frames import TcpFramer, UdpFramer, is_one_frame, mbap
from .call import Call, Matching, no_answer
from .statistics import Statistics

if TYPE_CHECKING:
    from ..ports.endpoint import Endpoint
    from ..ports.trace import Trace

__all__ = ["Ids", "first_id"]

_MBAP = struct.Struct(">HHHB")  # with the unit

# The most ids that are kept for late answers; requests need the others.
MAX_ABANDONED = 0x8000


def first_id() -> int:
    """
    Return the id before the first one, which each client takes at random: some gateways send an
    answer to all their clients, or a late one to the newest, and all would begin with the same.
    """
    return int.from_bytes(os.urandom(2), "big")


class Ids(Matching):
    """
    The requests in flight on one connection, by their transaction ids.

    With `any_unit`, other units may answer, because some devices always answer as unit 255. With
    `any_id`, a frame answers the only request in flight, whatever its id.
    """

    has_ids = True

    def __init__(
        self,
        endpoint: Endpoint,
        statistics: Statistics,
        trace: Trace,
        *,
        any_unit: bool = False,
        any_id: bool = False,
    ) -> None:
        super().__init__(statistics, trace)
        self._any_unit = any_unit
        self._any_id = any_id
        self._is_datagram = endpoint.framing == "udp"
        self._last = first_id()
        self._answered_at = 0.0
        self._abandoned: dict[int, None] = {}
        # Ids left unanswered by the connection before: a gateway may answer them on this one.
        self._owed: frozenset[int] = frozenset()
        # The units that answered, where these differ from the requested units.
        self._answerers: WeakKeyDictionary[Call, int] = WeakKeyDictionary()
        self.reset(0.0)

    def start(self, call: Call, now: float) -> bytes:
        number = self._last + 1 & 0xFFFF
        pending, pdu = self.pending, call.pdu
        while number in pending or number in self._abandoned:
            number = number + 1 & 0xFFFF
        self._last = number
        if not pending:
            self._strays = b""
            self._is_late = False
            self.unasked: int = 0
        if not call.is_silent:
            pending[number] = call
        return _MBAP.pack(number, 0, 1 + len(pdu), call.unit) + pdu

    # --- answers --------------------------------------------------------------------------

    def take(self, data: bytes, now: float) -> list[Call]:
        if not self.pending:
            self.unasked += len(data)
        calls: list[Call] = []
        framer = self._framer
        frame = framer.whole(data)
        for result in framer.scan(data) if frame is None else (frame,):
            if isinstance(result, FrameError):
                self._blame(result, calls)
                continue
            unit, pdu, number = result
            if self.is_traced:
                self._trace.tell("received", mbap(number, unit, pdu), unit, pdu[0])
            call = self.pending.pop(number, None)
            if call is None:
                if not (self._any_id and self.pending):
                    self._drop(number, mbap(number, unit, pdu))
                    continue
                _, call = self.pending.popitem()
            if call.unit == unit:
                call.answer(pdu)
            elif self._any_unit:
                call.answer(pdu)
                self._answerers[call] = unit
            else:
                self._statistics.invalid += 1
                error = InvalidResponse(
                    f'unit {unit} answered; accept_unit="any" would take it',
                    received=mbap(number, unit, pdu),
                )
                error.answers_another = True
                call.answer(error)
            calls.append(call)
        if calls:
            self.unanswered: int = 0
            self._answered_at = now
        return calls

    def _drop(self, number: int, adu: bytes) -> None:
        """
        Drop a frame. It does not end the count of unanswered requests, because some devices stay
        one answer behind until there is a new connection.
        """
        self._statistics.late_answers += 1
        if number in self._abandoned or number in self._owed:
            self._abandoned.pop(number, None)
            self._is_late = True
        else:
            self._keep_stray(adu)

    def _keep_stray(self, data: bytes) -> None:
        self._strays += data[: MAX_RECEIVED - len(self._strays)]

    def _blame(self, error: FrameError, calls: list[Call]) -> None:
        """Assign an error to its request; to all, if the stream cannot be understood any more."""
        self._statistics.invalid += 1
        if self.is_traced:
            self._trace.tell("received", error.received)
        if not self._framer.in_step:
            self.is_in_step = False
            for call in self.pending.values():
                call.answer(copy.copy(error))
                calls.append(call)
            self.pending.clear()
        elif self._is_datagram or _number(error.received) not in self.pending:
            self._keep_stray(error.received)
        else:
            self.pending[_number(error.received)].doubt(error)

    def drop_rest(self) -> bool:
        if self.pending or self._abandoned:
            return False
        self._framer.rest.clear()
        return True

    def received_with(self, call: Call, pdu: bytes) -> bytes:
        frame = mbap(_number(call.adu), self._answerers.get(call, call.unit), pdu)
        return frame if self.pending else frame + bytes(self.rest)

    # --- no answer ------------------------------------------------------------------------

    def expire(self, now: float) -> list[Call]:
        overdue: list[Call] = []
        for number, call in list(self.pending.items()):
            if call.deadline > now:
                self.wake(call.deadline)
                continue
            del self.pending[number]
            self._abandon(number)
            call.answer(call.reply or self._no_answer(call))
            self._statistics.timeouts += 1
            self.unanswered += call.sent_at >= self._answered_at
            overdue.append(call)
        return overdue

    def _no_answer(self, call: Call) -> ModbusError:
        timeout, number, rest = call.timeouts.timeout, call.adu[:2], bytes(self.rest)
        if rest[:2] == number:
            return no_answer(timeout, rest)
        error = no_answer(timeout, self._strays or rest)
        if self._strays[:2] not in (b"", number) and is_one_frame(self._strays):
            other = _number(self._strays)
            hint = 'ids="ignore" would take it'
            error.args = (f"{error.args[0]}: id {other}, not {_number(number)}; {hint}",)
            error.answers_another = True
        elif self._is_late:
            error.args = (f"{error.args[0]}, but that to an earlier request; a longer timeout=?",)
        return error

    def withdraw(self, call: Call, now: float) -> bool:
        number = _number(call.adu)
        if self.pending.get(number) is not call:
            return False
        del self.pending[number]
        self._abandon(number)
        return True

    def _abandon(self, number: int) -> None:
        self._abandoned[number] = None
        if len(self._abandoned) > MAX_ABANDONED:
            del self._abandoned[next(iter(self._abandoned))]

    def reset(self, now: float) -> list[Call]:
        calls = list(self.pending.values())
        self._owed = frozenset((*self.pending, *self._abandoned)) or self._owed
        self._framer: TcpFramer = (UdpFramer if self._is_datagram else TcpFramer)("client")
        self._begin_again(self._framer.rest)
        self._abandoned.clear()
        self._strays = b""
        self._is_late = False  # an answer to an earlier request came during this one
        return calls


def _number(data: bytes) -> int:
    return int.from_bytes(data[:2], "big")
