"""
The requests of one connection that are to be sent, and their order:

1. Callers take turns, each with its requests in their order.
2. A repetition is sent before what was submitted later, as far as one of both is a write; on a
   line, as far as both are for the same unit. So no write is ever sent after one that followed it.
3. Where several requests may be in flight (`Window`), a write is alone in flight, and those before
   it are over. `max_in_flight`, if it is given, lifts this; then a write is not repeated once
   another one has been sent.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection

from .call import Call, Matching, Phase
from .window import Window

__all__ = ["Queue"]

OVER = Phase.OVER


class Queue:
    """
    The requests of one connection that are to be sent.

    Args:
        is_ordered: True if a write is alone in flight.

    Attributes:
        waiting: the requests that were not sent yet.
        again: those to be sent again, each when it is due.
        lost: reads that are to be asked again alone (`Window`); nothing else is sent meanwhile.
        last_write: the number, among all frames, of the last write that was sent.
        alone: the write in flight, or to be sent again; or the read that is asked again alone.
    """

    def __init__(self, matching: Matching, window: Window, *, is_ordered: bool) -> None:
        self.waiting: deque[Call] = deque()
        self.again: list[Call] = []
        self.lost: list[Call] = []
        self.alone: Call | None = None
        self.last_write: int = 0
        self._matching = matching
        self._window = window
        self._is_ordered = is_ordered

    @property
    def calls(self) -> list[Call]:
        """The requests to be sent for the first time, and again when they are due."""
        return [*self.waiting, *self.again]

    def next(self, now: float, in_flight: int) -> Call | None:
        """
        Remove and return the next request to send; None, and the alarm is set, if none may be now.

        Args:
            in_flight: how many requests are in flight, those in `lost` not counted.
        """
        if not self._matching.has_ids:
            return None if in_flight else self._next_on_line(now)
        if self.alone is not None:
            return self._next_again(now)
        if self.lost or (in_flight and in_flight >= self._window.limit):
            return None
        if self.again and (call := self._next_again(now)) is not None:
            return call
        waiting = self.waiting
        while waiting:
            call = waiting.popleft()
            if call.state is not OVER:
                if call.changes and self._is_ordered and (in_flight or self.again):
                    waiting.appendleft(call)
                    return None
                return call
        return None

    def _next_again(self, now: float) -> Call | None:
        for call in list(self.again):
            if call.state is OVER:
                self.again.remove(call)
            elif self.alone is None or call is self.alone:
                if call.due <= now:
                    self.again.remove(call)
                    return call
                self._wake(call.due)
        return None

    def _next_on_line(self, now: float) -> Call | None:
        """As `next`; a request that waits holds back those for the same unit, and broadcasts."""
        held: set[int] = set()
        for calls in (self.again, self.waiting):
            for call in list(calls):
                if call.state is OVER:
                    calls.remove(call)
                elif 0 in held or call.unit in held or (call.unit == 0 and held):
                    held.add(call.unit)
                elif call.due > now:
                    self._wake(call.due)
                    held.add(call.unit)
                elif self._matching.may_start(call, now):
                    calls.remove(call)
                    return call
                else:
                    held.add(call.unit)
        return None

    def put_again(self, call: Call, due: float) -> None:
        """Send a request again at a time."""
        call.state = Phase.WAITING
        call.due = due
        self.again.append(call)
        self._wake(due)
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
        self.waiting = deque(call for call in self.waiting if call.state is not OVER)

    def drain(self, later: Collection[Call] = ()) -> list[Call]:
        """Remove and return all requests, except some."""
        calls = [*self.again, *self.lost, *self.waiting]
        if self.alone in self.again and self.alone not in later:
            self.alone = None
        self.again = [call for call in self.again if call in later]
        self.waiting = deque(call for call in self.waiting if call in later)
        self.lost.clear()
        return [call for call in calls if call not in later]

    def _wake(self, at: float) -> None:
        if at < self._matching.alarm:
            self._matching.alarm = at
