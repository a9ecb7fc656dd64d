"""
The order of the requests of one connection.

Callers take turns, each with its requests in their order. Nothing is sent while a request that must
come before it has no outcome yet: while it is in flight, or answered and not settled, or waits to
be repeated. Must come before it:

    where frames have ids    each request submitted earlier, if one of the two is a write
    on a line                each one submitted earlier to the same unit; to all units, if one of
                             the two is a broadcast

So with ids a write is alone from its sending to its outcome, and reads may share the connection, as
many as `max_in_flight` allows, those that a busy device is to be sent again among them. On a line
one request is in flight at a time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection

from .call import Call, Matching

__all__ = ["Queue"]


class Queue:
    """The requests of one connection that are to be sent; up to `limit` may be in flight."""

    def __init__(self, matching: Matching, limit: int) -> None:
        self.waiting: deque[Call] = deque()
        self.again: dict[Call, float] = {}  # when each is due to be sent again
        # Where frames have ids: the write that was sent and has no outcome yet.
        self.write: Call | None = None
        self.matching = matching
        self.limit = limit
        self.half: int = (limit + 1) // 2
        self._left = 0  # at most this many calls in `waiting` have callers that left
        self._has_ids = matching.has_ids

    @property
    def calls(self) -> list[Call]:
        """The requests to be sent again, and then those to be sent for the first time."""
        return [*self.again, *self.waiting]

    def next(self, now: float, in_flight: int, pending: Collection[Call]) -> Call | None:
        """
        Remove and return the next request; None, and the alarm is set, if none may be sent.

        The `unsettled` requests were answered, and have no outcome yet.
        """
        if not self._has_ids:
            return None if in_flight or pending else self._next_on_line(now)
        if self.write is not None:
            return self._next_again(now) if self.again else None
        if in_flight >= self.limit:
            return None
        if self.again:
            if (call := self._next_again(now)) is not None:
                return call
            if in_flight + len(self.again) >= self.limit > 1:
                return None
        waiting = self.waiting
        while waiting:
            call = waiting.popleft()
            if call.is_done:
                continue
            if call.changes and (in_flight or pending or self.again):
                waiting.appendleft(call)
                return None
            batch = call.batch
            if batch is not None and not batch.one_by_one and batch.waiting:
                waiting.append(batch.next())
            return call
        return None

    def _next_again(self, now: float) -> Call | None:
        for call, due in list(self.again.items()):
            if call.is_done:
                del self.again[call]
            elif due <= now:
                del self.again[call]
                return call
            else:
                self.matching.wake(due)
        return None

    def _next_on_line(self, now: float) -> Call | None:
        """As `next`; a request that waits holds back those for the same unit, and broadcasts."""
        units: set[int] = set()
        for call in self.calls:
            due = self.again.get(call, 0.0)
            if call.is_done:
                self.remove(call)
            elif 0 in units or call.unit in units or (call.unit == 0 and units):
                units.add(call.unit)
            elif due > now:
                self.matching.wake(due)
                units.add(call.unit)
            elif self.matching.may_start(call, now):
                self.remove(call)
                return call
            else:
                units.add(call.unit)
        return None

    def put_again(self, call: Call, due: float) -> None:
        """Send a request again at a time."""
        self.again[call] = due
        self.matching.wake(due)
        if call.changes:
            self.write = call

    def wait_again(self, calls: list[Call]) -> None:
        """Put requests that were sent back to the front; their time goes on."""
        self.waiting.extendleft(reversed(calls))
        for call in calls:
            self.matching.wake(call.deadline)

    def note_write(self, call: Call) -> None:
        """Note that a write was sent."""
        self.write = call

    def note_end(self, call: Call) -> None:
        """Note that a request has its outcome, or is forgotten."""
        if call is self.write:
            self.write = None

    def remove(self, call: Call) -> None:
        """Forget a request."""
        self.note_end(call)
        if self.again.pop(call, None) is None and call in self.waiting:
            self.waiting.remove(call)

    def leave(self, call: Call) -> None:
        """
        Forget a request whose caller is gone. Many may leave at once, so those that wait are looked
        through once half of them have left: they are never the only ones.
        """
        self.note_end(call)
        self.again.pop(call, None)
        self._left += 1
        if 2 * self._left >= len(self.waiting):
            self._left = 0
            self.waiting = deque(call for call in self.waiting if not call.is_done)

    def drain(self, later: Collection[Call] = ()) -> list[Call]:
        """Remove and return all requests, except some."""
        calls = [*self.again, *self.waiting]
        self.again = {call: due for call, due in self.again.items() if call in later}
        self.waiting = deque(call for call in self.waiting if call in later)
        others = [call for call in calls if call not in later]
        for call in others:
            self.note_end(call)
        return others

    def clear(self) -> None:
        """Forget all requests, and those in flight."""
        self.waiting.clear()
        self.again.clear()
        self.write = None
