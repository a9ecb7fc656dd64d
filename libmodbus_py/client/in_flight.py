"""
Many requests at once, told apart by their transaction ids: Modbus/TCP, and UDP.
"""

from __future__ import annotations

import copy
from typing import Any

from ..protocol.errors import FrameError, InvalidResponse, ModbusError
from ..protocol.framing import Frame, Framer, make_framer, mbap
from .batch import Batch, Pending, Reply
from .conversation import Conversation, no_answer

__all__ = ["InFlight"]

# So many late answers are waited for; there must be ids left for requests.
MAX_ABANDONED = 0x8000

# What errors can carry; more of the same tells no more.
MAX_KEPT = 600


class InFlight(Conversation):
    """
    See `Conversation`. An id is used again after all others were, and not while its late
    answer may come.

    Args:
        any_unit: whether answers may come from another unit than the one asked, as from
            devices that are 255 to everybody.
    """

    def __init__(self, *args: Any, any_unit: bool = False, **options: Any) -> None:
        self._any_unit = any_unit
        self._last = 0
        self._asked: dict[int, Pending] = {}
        self._abandoned: dict[int, None] = {}
        self._rest = b""
        self._strays = b""
        # Id -> what came in place of its answer while the wait goes on.
        self._wrong: dict[int, FrameError] = {}
        # Id -> who answered, where that may be anybody.
        self._units: dict[int, int] = {}
        super().__init__(*args, **options)

    def _make_framer(self) -> Framer:
        return make_framer(self._framing, "client")

    @property
    def is_plain(self) -> bool:
        return (
            self._room == self.limit
            and self.connection.is_open
            and not (self._abandoned or self._unanswered or self._rest or self._repeats)
            and not self._trace.is_on
        )

    def _is_spent(self) -> bool:
        """Also when half a frame was left, which the next answer would be taken into."""
        return super()._is_spent() or (self._rest != b"" and not self._asked)

    def next_number(self) -> int:
        """Give an id that no request in flight has, and no answer that may still come."""
        number = self._last + 1 & 0xFFFF
        while number in self._asked or number in self._abandoned:
            number = number + 1 & 0xFFFF
        self._last = number
        return number

    def _register(self, batch: Batch, adu: bytes, now: float) -> None:
        self._strays = b""
        self._asked[int.from_bytes(adu[:2], "big")] = Pending(batch, 0, adu, now)

    def _begin(self, batch: Batch, index: int, now: float) -> Pending:
        if not self._asked:
            self._strays = b""
            self._wrong.clear()
            self._units.clear()
        number = self.next_number()
        adu = mbap(number, batch.unit, batch.pdus[index])
        asked = Pending(batch, index, adu, now)
        if not (batch.silent and batch.silent[index]):
            self._asked[number] = asked
        return asked

    def _take(self, data: bytes, now: float) -> None:
        is_on = self._trace.is_on
        answers = 0
        if not self._asked:
            self._note_unasked(len(data))
        for each in self._framer.scan(data):
            if isinstance(each, FrameError):
                self._blame(each)
                continue
            unit, pdu, number = each
            if is_on:
                self._trace.tell("received", self._framer.encode(each), unit, pdu[0])
            asked = self._asked.pop(number, None)
            if asked is None:
                self._drop(each, now)
            elif asked.batch.unit == unit or self._any_unit:
                answers += 1
                if self._any_unit:
                    self._units[number] = unit
                self._found.append((asked, pdu))
            else:
                self._found.append((asked, self._other_unit(each)))
        if answers:
            self._note_life(now)
        pending = self._framer.pending
        self._rest = (self._rest + data)[-pending:] if pending else b""

    def _drop(self, frame: Frame, now: float) -> None:
        """An answer that comes late proves that somebody is there; one to nobody does not."""
        self.statistics.late_answers += 1
        if frame.transaction in self._abandoned:
            del self._abandoned[frame.transaction]
            self._note_life(now)
        else:
            self._keep_stray(self._framer.encode(frame))

    def _keep_stray(self, data: bytes) -> None:
        self._strays += data[: MAX_KEPT - len(self._strays)]

    def _other_unit(self, frame: Frame) -> InvalidResponse:
        self.statistics.invalid += 1
        error = InvalidResponse(
            f'unit {frame.unit} answered; accept_unit="any" would take it',
            received=self._framer.encode(frame),
        )
        error.answers_another = True
        return error

    def _blame(self, error: FrameError) -> None:
        """Find whose answer it should have been: all, when nothing can be understood any more."""
        self.statistics.invalid += 1
        if self._trace.is_on:
            self._trace.tell("received", error.received)
        if not self._framer.in_step:
            self._break("closed, for what came cannot be understood")
            asked, self._asked = self._asked, {}
            for each in asked.values():
                self._found.append((each, copy.copy(error)))
        elif self._framing == "udp":
            self._keep_stray(error.received)  # the next datagram may be the right one
        elif (number := int.from_bytes(error.received[:2], "big")) in self._asked:
            self._wrong[number] = error  # a better one may follow
            if len(self._wrong) > self.limit:
                self._wrong = {each: self._wrong[each] for each in self._wrong.keys() & self._asked}

    def _overdue(self, now: float) -> list[tuple[Pending, Reply]]:
        overdue: list[tuple[Pending, Reply]] = []
        for number, asked in list(self._asked.items()):
            if asked.deadline > now:
                self._wake(asked.deadline)
                continue
            self._abandon(number)
            overdue.append((asked, self._wrong.get(number) or self._no_answer(asked)))
        return overdue

    def _no_answer(self, asked: Pending) -> ModbusError:
        timeout = asked.batch.timeouts.timeout
        begun = self._rest and int.from_bytes(self._rest[:2], "big") not in self._asked
        if begun or not self._strays:
            return no_answer(timeout, self._rest if begun else b"")
        error = no_answer(timeout, self._strays)
        number, other = (int.from_bytes(each[:2], "big") for each in (asked.adu, self._strays))
        if number != other:
            error.args = (f"{error.args[0]}: id {other}, not {number}",)
            error.answers_another = True
        return error

    def _abandon(self, number: int) -> None:
        del self._asked[number]
        self._abandoned[number] = None
        if len(self._abandoned) > MAX_ABANDONED:
            del self._abandoned[next(iter(self._abandoned))]

    def _received_with(self, asked: Pending, pdu: bytes) -> bytes:
        number = int.from_bytes(asked.adu[:2], "big")
        frame = mbap(number, self._units.get(number, asked.batch.unit), pdu)
        return frame if self._asked else frame + self._rest

    def _give_up(self, batch: Batch, now: float) -> list[Pending]:
        given_up = {number: asked for number, asked in self._asked.items() if asked.batch is batch}
        for number in given_up:
            self._abandon(number)
        return list(given_up.values())

    def _forget(self, now: float) -> list[Pending]:
        asked = list(self._asked.values())
        self._asked = {}
        self._abandoned = {}
        self._rest = self._strays = b""
        return asked
