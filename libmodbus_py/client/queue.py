"""
The order of the requests of one connection, and how many may be in flight.

The order (`Queue`):

1. Callers take turns, each with its requests in their order.
2. A repetition is sent before what was submitted later, as far as one of both is a write; on a
   line, as far as both are for the same unit. So no write is ever sent after one that followed it.

The number where frames have transaction ids (`Window`). Many devices lose all but one of the
requests that arrive together, so it is found out:

1. A write is alone: nothing else is in flight while it is, and those before it are over.
2. Reads: one, then two, four and so on, as long as all of them are answered.
3. A read that was sent beside others is lost if it gets no answer within a quarter of its timeout,
   or within twice the time of the slowest answer if that is longer; or if it is refused because the
   device is busy. It is asked again alone.
4. If it is answered then, the device takes one request at a time: all clients of this process send
   one at a time to this endpoint, for the life of the process. If its first answer came meanwhile,
   the device was only slow: half as many may be in flight on this connection.
5. A unit that does not answer even alone is not asked again alone until it answers.

`max_in_flight`, if it is given, sets the number, and none of these five rules applies; then a write
is not repeated once another one has been sent.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Hashable, Mapping
from typing import TYPE_CHECKING

from ..protocol.checks import log_warning
from ..protocol.errors import ModbusError, ServerDeviceBusy
from .call import Call, Matching, Phase

if TYPE_CHECKING:
    from ..ports.endpoint import Endpoint
    from .statistics import Statistics

__all__ = ["ONE_AT_A_TIME", "Queue", "Window"]

ONE_AT_A_TIME: set[Hashable] = set()
"""The places of the endpoints that take one request at a time; see rule 4."""


class Window:
    """The number of requests that may be in flight: `most` if it is given, else found out."""

    def __init__(
        self, endpoint: Endpoint, most: int, is_given: bool, statistics: Statistics
    ) -> None:
        self.is_open: bool = not is_given and most > 1
        self.silent: set[tuple[int, int]] = set()  # units and functions; see rule 5
        self._place: Hashable = endpoint.key
        self._name = str(endpoint)
        self._most = self._bound = most
        self.number: int = 1 if self.is_open else most  # found out by now
        self._count = 0  # answers since the number was changed
        self._was_full = self.is_open  # since then; one request is all that may be in flight
        self._slowest = 0.0  # seconds
        self._statistics = statistics

    @property
    def limit(self) -> int:
        """The number of requests that may be in flight now."""
        return 1 if ONE_AT_A_TIME and self.is_at_one else self.number

    @property
    def is_at_one(self) -> bool:
        """True if the endpoint was found to take one request at a time."""
        return self.is_open and self._place in ONE_AT_A_TIME

    def reset(self) -> None:
        """Begin again for another connection."""
        self.silent.clear()
        if self.is_open:
            self.number, self._bound, self._count, self._was_full = 1, self._most, 0, True
            self._slowest = 0.0

    def sent(self, call: Call, others: int, matching: Matching) -> None:
        """Note that a read is sent beside others, and when they are lost; see rule 3."""
        for each in matching.pending.values() if others == 1 else (call,):
            if not (each.changes or (self.silent and (each.unit, each.pdu[0]) in self.silent)):
                quarter, twice = each.timeouts.timeout / 4, 2 * self._slowest
                each.lost_at = at = each.sent_at + (quarter if quarter > twice else twice)
                if at < matching.alarm:
                    matching.alarm = at
        if others + 1 >= self.number:
            self._was_full = True

    def answered(self, call: Call, took: float, pending: Mapping[int, Call]) -> None:
        """Note a valid answer; the number doubles once so many, and all before, were answered."""
        if took > self._slowest:
            self._slowest = took
        if self.silent:
            self.silent.discard((call.unit, call.pdu[0]))
        if self._was_full and self.number < self._bound:
            self._count += 1
            oldest = next(iter(pending.values()), call)
            if self._count >= self.number and oldest.order >= call.order:  # else it may be lost
                self.number = min(2 * self.number, self._bound)
                self._count, self._was_full = 0, False

    def is_lost(self, error: ModbusError, call: Call) -> bool:
        """Return True if a read that failed is asked again alone; see rule 3."""
        return (
            call.lost_at < math.inf
            and call.is_wanted
            and isinstance(error, TimeoutError | ServerDeviceBusy)
            and (call.unit, call.pdu[0]) not in self.silent
        )

    def missed(self, call: Call) -> None:
        """Note that a read was not answered even alone."""
        self.silent.add((call.unit, call.pdu[0]))

    def halve(self) -> None:
        """Note that reads were answered too late beside others."""
        self.number = self._bound = max(1, self.number // 2)

    def take_one(self) -> None:
        """Note that a read was lost beside others, and answered alone."""
        if self._place in ONE_AT_A_TIME:
            return
        ONE_AT_A_TIME.add(self._place)
        self._statistics.falls += 1
        log_warning(
            __name__,
            "%s: requests that are sent together are lost, but answered when sent alone; from now "
            "on one is sent at a time (max_in_flight=1; another max_in_flight sets the number)",
            self._name,
        )


class Queue:
    """The requests of one connection that are to be sent; `is_ordered` if a write is alone."""

    def __init__(self, matching: Matching, window: Window, *, is_ordered: bool) -> None:
        self.waiting: deque[Call] = deque()
        self.again: list[Call] = []  # each when it is due
        # Reads that are to be asked again alone (`Window`); nothing else is sent meanwhile.
        self.lost: list[Call] = []
        # The write in flight, or to be sent again; or the read that is asked again alone.
        self.alone: Call | None = None
        self.last_write: int = 0  # its number among all frames
        self.matching = matching
        self.window = window
        self._has_ids = matching.has_ids
        self._is_ordered = is_ordered

    @property
    def calls(self) -> list[Call]:
        """The requests to be sent for the first time, and again when they are due."""
        return [*self.waiting, *self.again]

    def next(self, now: float, in_flight: int) -> Call | None:
        """Remove and return the next request; None, and the alarm is set, if none may be sent."""
        if not self._has_ids:
            return None if in_flight else self._next_on_line(now)
        if self.alone is not None:
            return self._next_again(now)
        window = self.window  # its `limit`, without a call for each request
        is_full = in_flight >= window.number or (ONE_AT_A_TIME and window.is_at_one)
        if self.lost or (in_flight and is_full):
            return None
        if self.again and (call := self._next_again(now)) is not None:
            return call
        waiting = self.waiting
        while waiting:
            call = waiting.popleft()
            if not call.is_done:
                if call.changes and self._is_ordered and (in_flight or self.again):
                    waiting.appendleft(call)
                    return None
                return call
        return None

    def _next_again(self, now: float) -> Call | None:
        for call in list(self.again):
            if call.is_done:
                self.again.remove(call)
            elif self.alone is None or call is self.alone:
                if call.due <= now:
                    self.again.remove(call)
                    return call
                self.matching.wake(call.due)
        return None

    def _next_on_line(self, now: float) -> Call | None:
        """As `next`; a request that waits holds back those for the same unit, and broadcasts."""
        held: set[int] = set()
        for calls in (self.again, self.waiting):
            for call in list(calls):
                if call.is_done:
                    calls.remove(call)
                elif 0 in held or call.unit in held or (call.unit == 0 and held):
                    held.add(call.unit)
                elif call.due > now:
                    self.matching.wake(call.due)
                    held.add(call.unit)
                elif self.matching.may_start(call, now):
                    calls.remove(call)
                    return call
                else:
                    held.add(call.unit)
        return None

    # --- reads that are lost beside others (`Window`) ------------------------------------------

    def choose_alone(self, now: float) -> list[Call]:
        """Choose the lost read that is asked again alone; return those that are not asked again."""
        left: list[Call] = []
        while self.lost:
            call = self.lost.pop(0)
            if call.is_done:
                continue
            if call.is_wanted and (call.unit, call.pdu[0]) not in self.window.silent:
                call.due = now
                call.lost_at = math.inf
                self.again.append(call)
                self.alone = call
                break
            left.append(call)
        return left

    # --- repetitions --------------------------------------------------------------------------

    def put_again(self, call: Call, due: float) -> None:
        """Send a request again at a time."""
        call.state = Phase.WAITING
        call.due = due
        self.again.append(call)
        self.matching.wake(due)
        if call.changes and self._is_ordered:
            self.alone = call

    def note_write(self, call: Call) -> None:
        """Note that a write is in flight."""
        self.last_write = call.order
        if self._is_ordered:
            self.alone = call

    def remove(self, call: Call) -> None:
        """Forget a request."""
        if call is self.alone:
            self.alone = None
        for calls in (self.waiting, self.again, self.lost):
            if call in calls:
                calls.remove(call)

    def remove_over(self) -> None:
        """Forget new requests whose callers are gone."""
        self.waiting = deque(call for call in self.waiting if not call.is_done)

    def drain(self, later: Collection[Call] = ()) -> list[Call]:
        """Remove and return all requests, except some."""
        calls = [*self.again, *self.lost, *self.waiting]
        if self.alone in self.again and self.alone not in later:
            self.alone = None
        self.again = [call for call in self.again if call in later]
        self.waiting = deque(call for call in self.waiting if call in later)
        self.lost.clear()
        return [call for call in calls if call not in later]
