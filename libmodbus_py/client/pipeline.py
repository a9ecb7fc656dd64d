"""
Many requests, in flight together where frames have transaction ids, else in turn.

Nothing here opens or closes a connection: that is for the line.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from ..ports.link import TIMEOUTS_BEFORE_RECONNECT, Link
from ..protocol.errors import (
    ExceptionResponse,
    FrameError,
    InvalidResponse,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    alike,
)
from ..protocol.framing import Frame, Framer
from ..protocol.pdu import Request

__all__ = ["MAX_IN_FLIGHT", "Pipeline", "one_by_one"]

# As many requests and answers of full length as the buffers of two sockets hold: with
# more, both sides might wait for the other to read before they go on.
MAX_IN_FLIGHT = 256

# A host that refuses connections, or drops them unanswered, will do so again.
LOSSES_BEFORE_END = 3

Answer = tuple[int, bytes, Frame]  # the place of the request, its ADU, what came back


class Pipeline:
    """
    Requests on their way to one unit; answers are told apart by their ids.

    Args:
        unit: who is asked.
        requests: what is asked.
        max_in_flight: how many may wait for their answer at a time.
        timeout: seconds for each, from when it is sent.
        tolerated: the errors after which the rest is sent all the same.
        next_transaction: gives an id that no answer on its way has.
        abandoned: ids of requests that may be answered though nobody waits any
            more; kept up to date.

    Attributes:
        outcomes: for each request its result or its ModbusError.
        late_answers: how many answers came when nobody waited for them.
        timeouts: how many requests in a row have had no answer, with nothing else
            coming in either.
        had_trouble: whether anything failed, refusals apart.
    """

    def __init__(
        self,
        unit: int,
        requests: Sequence[Request[Any]],
        *,
        max_in_flight: int,
        timeout: float,
        tolerated: tuple[type[ModbusError], ...],
        next_transaction: Callable[[], int],
        abandoned: set[int],
    ) -> None:
        self.outcomes: list[Any] = [None] * len(requests)
        self.late_answers = 0
        self.timeouts = 0
        self.had_trouble = False
        self._unit = unit
        self._requests = requests
        self._max_in_flight = max_in_flight
        self._timeout = timeout
        self._tolerated = tolerated
        self._next_transaction = next_transaction
        self._abandoned = abandoned
        self._in_flight: dict[int, tuple[int, bytes, float]] = {}  # place, ADU, deadline by id
        self._sent = 0
        self._end = len(requests)  # what comes from here on does not matter any more
        self._losses = 0
        self._last_answer = 0.0

    @property
    def is_done(self) -> bool:
        """Whether there is an outcome for all that matters."""
        return self._sent >= self._end and all(
            place >= self._end for place, _, _ in self._in_flight.values()
        )

    def run(self, link: Link, framer: Framer) -> None:
        """
        Send and receive until it is done, or the connection seems to be dead.

        Raises:
            ModbusError: the connection is of no use any more.
        """
        for _ in range(2):
            self._send(link, framer)
        while self._in_flight and not self.is_done:
            answers, broken = self._receive(link, framer)
            try:
                # Before they are decoded, so that the server has work meanwhile; but
                # not after a refusal, which may be the end.
                if broken is None and not any(answer.pdu[0] & 0x80 for *_, answer in answers):
                    self._send(link, framer)
            finally:
                for answer in answers:
                    self._conclude(framer, *answer)
            if broken is not None:
                raise broken
            self._expire()
            self._send(link, framer)

    def lose(self, error: ModbusError) -> None:
        """
        Fail what was in flight on a connection that is no more.

        Where nothing was, there was no connection for the next one.
        """
        self._losses += 1
        lost = [(place, adu) for place, adu, _ in self._in_flight.values()]
        if not lost and self._sent < self._end:
            lost = [(self._sent, b"")]
            self._sent += 1
        if self._losses >= LOSSES_BEFORE_END:
            lost += [(place, b"") for place in range(self._sent, self._end)]
            self._sent = self._end
        self._in_flight.clear()
        for place, adu in lost:
            self._fail(place, adu, alike(error))

    def leave(self) -> None:
        """Wait no more for what is in flight."""
        self._abandon(list(self._in_flight))

    def _send(self, link: Link, framer: Framer) -> None:
        """Send half of them at most: one half is answered while we deal with the other."""
        room = min(
            self._max_in_flight - len(self._in_flight),
            (self._max_in_flight + 1) // 2,
            self._end - self._sent,
        )
        if room <= 0 or self.timeouts >= TIMEOUTS_BEFORE_RECONNECT:
            return
        deadline = time.monotonic() + self._timeout
        adus = []
        for place in range(self._sent, self._sent + room):
            transaction = self._next_transaction()
            while transaction in self._in_flight:
                transaction = self._next_transaction()
            frame = Frame(self._unit, self._requests[place].encode(), transaction)
            adu = framer.encode(frame)
            self._in_flight[transaction] = place, adu, deadline
            adus.append(adu)
        self._sent += room
        link.send_many(adus, deadline)

    def _receive(self, link: Link, framer: Framer) -> tuple[list[Answer], FrameError | None]:
        """Give the answers that came, and what came in place of one."""
        oldest = next(iter(self._in_flight.values()))
        found = [each for data in link.receive_many(oldest[2]) for each in framer.scan(data)]
        answers = []
        broken = None
        for each in found:
            if isinstance(each, FrameError):
                broken = broken or each
            elif each.transaction in self._in_flight:
                place, adu, _ = self._in_flight.pop(each.transaction)
                answers.append((place, adu, each))
            else:
                self.late_answers += 1
                self._abandoned.discard(each.transaction)
        if answers:
            self.timeouts = self._losses = 0
            self._last_answer = time.monotonic()
        # A damaged datagram says nothing about the next one.
        return answers, None if link.datagrams else broken

    def _conclude(self, framer: Framer, place: int, adu: bytes, answer: Frame) -> None:
        try:
            if answer.unit != self._unit:
                raise InvalidResponse(f"unit {answer.unit} answered")
            self.outcomes[place] = self._requests[place].decode_response(answer.pdu)
        except ModbusError as error:
            error.received = framer.encode(answer)
            self._fail(place, adu, error)

    def _expire(self) -> None:
        now = time.monotonic()
        expired = [each for each, (_, _, deadline) in self._in_flight.items() if deadline <= now]
        for transaction in expired:
            place, adu, deadline = self._in_flight[transaction]
            self.timeouts += deadline >= self._last_answer + self._timeout
            self._fail(place, adu, ModbusTimeoutError(f"no answer within {self._timeout:g} s"))
        self._abandon(expired)

    def _abandon(self, transactions: list[int]) -> None:
        self._abandoned.update(transactions)
        for transaction in transactions:
            del self._in_flight[transaction]

    def _fail(self, place: int, adu: bytes, error: ModbusError) -> None:
        request = self._requests[place]
        error.unit, error.function, error.asked = self._unit, request.function, str(request)
        error.sent = adu
        error.__traceback__ = None  # it would keep alive all that was asked and answered
        self.outcomes[place] = error
        self.had_trouble = self.had_trouble or not isinstance(error, ExceptionResponse)
        if not isinstance(error, self._tolerated):
            self._end = min(self._end, place)


def one_by_one(
    execute: Callable[[Request[Any]], Any],
    requests: Sequence[Request[Any]],
    *,
    return_exceptions: bool,
) -> list[Any]:
    """Give the outcome of each, and spare a dead host all but three attempts to connect."""
    outcomes: list[Any] = []
    losses = 0
    for request in requests:
        if losses >= LOSSES_BEFORE_END:
            error = alike(outcomes[-1])
            error.function, error.asked = request.function, str(request)
            error.sent = error.received = b""
            outcomes.append(error)
            continue
        try:
            outcomes.append(execute(request))
            losses = 0
        except ModbusError as error:
            if not return_exceptions:
                raise
            losses = losses + 1 if isinstance(error, ModbusConnectionError) else 0
            error.__traceback__ = None
            outcomes.append(error)
    return outcomes
