"""
One connection to a line or a device that is shared: which request is sent next, and when.

A request waits, is in flight, and is over. There are two kinds:

* Others: requests to units that answered the last time. Urgent ones come first.
* Trials: requests to units that gave no answer the last time.

Those of each kind take turns (`FairQueue`): hosts, within each host its clients, and the requests
of each client keep their order.

The rules:

1. As many requests are in flight as the client has room for, at least one.
2. On a line without transaction ids a unit is not asked while its late answer may still come
   (`Sender.ready_at`); requests to other units overtake it.
3. A trial is sent when no other request waits. When that does not happen, it is sent after it
   waited for one timeout, but no two trials in a row.
4. A trial that others wait for ends after the time of the slowest answers on this line, because
   it must not cost more than one of them. One in sixteen has its whole timeout: the unit may have
   become slower than all others.
5. A request that no client waits for any more, or that waited for too long, is not sent.
"""

from __future__ import annotations

import asyncio
import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Hashable, Iterator
from functools import partial
from typing import Any, Generic, TypeVar

from ..client.asynchronous import AsyncClient
from ..client.sender import Sender, Submitted
from ..ports.waiting_async import Alarm
from ..protocol.errors import ExceptionResponse, ModbusTimeoutError

__all__ = ["FairQueue", "LineRequest", "SharedLine", "rest_after"]

SHORTEST_TRIAL_S = 0.02
"""The least time of a trial that others wait for: a few requests of a fast line."""

FADING = 0.95
"""The share of a unit's longest response time that is kept with each further answer."""

TRIALS_BEFORE_LONG = 16
"""One trial of a unit in so many has its whole timeout."""

MOST_DOUBLINGS = 20
"""The most doublings of a rest, so that no number grows without bound."""


def rest_after(misses: int, first: float, longest: float) -> float:
    """Return the seconds that a unit rests after so many misses in a row, 1 or more."""
    rest: float = first * 2 ** min(misses - 1, MOST_DOUBLINGS)
    return min(rest, max(longest, first))


class LineRequest:
    """A request that a line sends, or several, one after the other."""

    # fmt: off
    __slots__ = (
        "asked_at", "client", "host", "is_trial", "is_urgent", "misses", "request", "submitted",
        "unit", "waits_since",
    )
    # fmt: on

    def __init__(
        self, unit: int, request: Any = None, *, host: Hashable = None, client: Hashable = None
    ) -> None:
        self.unit: int = unit
        self.request: Any = request
        self.host: Hashable = host
        self.client: Hashable = client
        self.is_urgent: bool = False
        self.is_trial: bool = False
        self.misses: int = 0  # of the unit, in a row
        self.waits_since: float = 0.0
        self.asked_at: float = 0.0
        self.submitted: Submitted | None = None  # while it is in flight


Each = TypeVar("Each", bound=LineRequest)


class FairQueue(Generic[Each]):
    """Requests that wait: hosts take turns, within each its clients, which keep their order."""

    def __init__(self, most_of_client: float = math.inf, most: float = math.inf) -> None:
        self._most_of_client = most_of_client
        self._most = most
        # The host, and within it the client, whose turn is next is first.
        self._hosts: dict[Hashable, dict[Hashable, deque[Each]]] = {}
        self.count: int = 0

    def __iter__(self) -> Iterator[Each]:
        return (each for host in self._hosts.values() for queue in host.values() for each in queue)

    def put(self, each: Each) -> bool:
        """Add a request; return False if too many wait."""
        clients = self._hosts.get(each.host, {})
        queue = clients.get(each.client, deque())
        if self.count >= self._most or len(queue) >= self._most_of_client:
            return False
        queue.append(each)
        self._hosts[each.host] = clients
        clients[each.client] = queue
        self.count += 1
        return True

    def pick(self, may_ask: Callable[[Each], bool]) -> Each | None:
        """Remove and return the first request that may be asked now; None if none may."""
        each = next(filter(may_ask, self), None)
        if each is not None:
            self.remove(each)
            if clients := self._hosts.pop(each.host, None):
                self._hosts[each.host] = clients
                if queue := clients.pop(each.client, None):
                    clients[each.client] = queue
        return each

    def remove(self, each: Each) -> bool:
        """Remove a request; return False if it does not wait here."""
        clients = self._hosts.get(each.host, {})
        queue = clients.get(each.client, deque())
        if each not in queue:
            return False
        queue.remove(each)
        self.count -= 1
        if not queue:
            del clients[each.client]
            if not clients:
                del self._hosts[each.host]
        return True


class SharedLine(ABC, Generic[Each]):
    """One connection, and the requests that share it; trials may wait for any time."""

    def __init__(
        self,
        sender: Sender,
        make_queue: Callable[[], FairQueue[Each]],
        *,
        longest_wait: float = math.inf,
        most_trials: float = math.inf,
    ) -> None:
        self.client: AsyncClient = sender.client
        self.sender: Sender = sender
        self.in_flight: dict[Each, None] = {}  # in the order in which they were sent
        self.is_closed: bool = False
        self._loop = asyncio.get_running_loop()
        self._has_ids = sender.has_ids
        self._longest_wait = longest_wait
        self._most_trials = most_trials
        self._urgent, self._usual = make_queue(), make_queue()
        self._trials: FairQueue[Each] = FairQueue()
        self._trying: dict[Each, None] = {}  # the trials in flight, in their order
        self._was_trial = False  # the request that was sent last
        # Unit -> the longest time that its answers took, fading.
        self._took: dict[int, float] = {}
        self._failed_at = 0.0
        self._done: list[Each] = []
        self._alarm = Alarm(self.go_on)
        self._next_at = math.inf

    # --- what the users of a line decide ------------------------------------------------------

    @abstractmethod
    def conclude(self, each: Each, outcome: Any, now: float) -> None:
        """Take the outcome of a request: its result, or an exception."""

    def sender_of(self, each: Each) -> Sender:
        """Return what sends a request, with the timeout of the request."""
        return self.sender

    def give_up(self, each: Each, now: float) -> None:
        """Conclude a trial that made way for others."""
        self.conclude(each, ModbusTimeoutError("no answer while others waited"), now)

    def expire(self, each: Each, now: float) -> None:
        """Conclude a request that waited for too long, and was not sent."""
        self.conclude(each, ModbusTimeoutError("not sent: others took too long"), now)

    # --- requests -----------------------------------------------------------------------------

    @property
    def waiting(self) -> int:
        """The number of requests that wait, trials excepted."""
        return self._urgent.count + self._usual.count

    def others(self) -> list[Each]:
        """Return the requests that wait, trials excepted."""
        return [*self._urgent, *self._usual]

    def ask(self, each: Each, now: float) -> bool:
        """Send a request now, or when it is its turn; return False if too many wait."""
        is_next = not (each.is_trial or self.is_closed or self._trials.count or self.waiting)
        if is_next and not self._is_full() and self._ready_at(each) <= now:
            self._send(each, now)
            return True
        queue = self._trials if each.is_trial else self._usual
        if not (self._urgent if each.is_urgent else queue).put(each):
            return False
        self.go_on()
        return True

    def drop(self, each: Each) -> bool:
        """Do not send a request; return False if it was sent already, or is over."""
        if each.submitted is None:
            if not self.remove(each):
                return False
        elif each.submitted.send_no_more():
            self._end(each)
        else:
            return False
        self._go_on_soon()
        return True

    def withdraw(self, each: Each) -> None:
        """Forget a request, in whatever state it is."""
        if each.submitted is None:
            self.remove(each)
        else:
            if each in self._done:
                self._done.remove(each)
            else:
                each.submitted.withdraw()
            self._end(each)
        self._go_on_soon()

    def remove(self, each: Each) -> bool:
        """Remove a request that waits; return False if it does not."""
        return any(queue.remove(each) for queue in (self._urgent, self._usual, self._trials))

    def stop(self) -> list[Each]:
        """Send nothing any more; remove and return all requests that wait."""
        self.is_closed = True
        self._alarm.cancel()
        waiting = [*self.others(), *self._trials]
        for each in waiting:
            self.remove(each)
        return waiting

    async def close(self) -> None:
        """Close the connection for good; requests in flight are concluded with its error."""
        self.stop()
        await self.client.close()
        self._finish()

    # --- who is next --------------------------------------------------------------------------

    def go_on(self, now: float | None = None) -> None:
        """
        Send what may be sent now, or at the time that the alarm was set for, and set it for the
        rest.
        """
        if self.is_closed:
            return
        now = self._loop.time() if now is None else now
        while (each := self._pick(now)) is not None:
            if each.is_trial or now - each.waits_since <= self._longest_wait:
                self._send(each, now)
            else:
                self.expire(each, now)
        if self._trying:
            self._end_overstayed(now)
        if self._next_at < self._alarm.at:
            self._alarm.set(self._next_at, self._loop)

    def _is_full(self) -> bool:
        return bool(self.in_flight) and len(self.in_flight) >= self.sender.room

    def _ready_at(self, each: Each) -> float:
        if self._has_ids:
            return 0.0
        return self.sender.ready_at(each.unit, each.request.function)

    def _pick(self, now: float) -> Each | None:
        """Remove and return the request to send now; None if none may be."""
        self._next_at = math.inf
        if not (self._trials.count or self.waiting) or self._is_full():
            return None

        def may_ask(each: Each) -> bool:
            at = self._ready_at(each)
            if at > now:
                self._next_at = min(self._next_at, at)
            return at <= now

        each = self._trials.pick(may_ask) if self._is_trial_due(now) else None
        each = each or self._urgent.pick(may_ask) or self._usual.pick(may_ask)
        if each is None and len(self._trying) < self._most_trials:
            each = self._trials.pick(may_ask)
        return each

    def _is_trial_due(self, now: float) -> bool:
        """Return True if a trial is to be sent before others, which wait."""
        first = next(iter(self._trials), None)
        if first is None or self._trying or self._was_trial:
            return False
        return now - first.waits_since >= self.sender_of(first).client.timeout

    def _end_overstayed(self, now: float) -> None:
        """End a trial that others have waited for, for long enough."""
        each = next((each for each in self._trying if each.misses % TRIALS_BEFORE_LONG), None)
        if each is None or not self.waiting or not self._is_full():
            return
        took = max([SHORTEST_TRIAL_S, *self._took.values()])
        until = each.asked_at + min(self.sender_of(each).client.timeout, took)
        if until > now:
            self._next_at = min(self._next_at, until)
            return
        assert each.submitted is not None
        if not (each.submitted.is_answered or each in self._done):
            each.submitted.withdraw()
            self._end(each)
            self.give_up(each, now)
            self.go_on()

    # --- in flight ----------------------------------------------------------------------------

    def _send(self, each: Each, now: float) -> None:
        self.in_flight[each] = None
        self._was_trial = each.is_trial
        if each.is_trial:
            self._trying[each] = None
        each.asked_at = now
        each.submitted = self.sender_of(each).submit(
            each.unit, each.request, partial(self._note_done, each)
        )

    def _end(self, each: Each) -> None:
        each.submitted = None
        del self.in_flight[each]
        self._trying.pop(each, None)

    def _note_done(self, each: Each) -> None:
        self._go_on_soon()
        self._done.append(each)

    def _go_on_soon(self) -> None:
        if not self._done:
            self._loop.call_soon(self._finish)

    def _finish(self) -> None:
        """Conclude the requests that are done, all at once, and send the next ones."""
        done, self._done = self._done, []
        now = self._loop.time()
        for each in done:
            if each.submitted is None:  # withdrawn because of what was concluded before
                continue
            outcome: Any = each.submitted.outcome
            self._end(each)
            if isinstance(outcome, BaseException) and not isinstance(outcome, ExceptionResponse):
                self._failed_at = now
            elif outcome is not None:
                # It may have been sent after one that failed.
                took = now - max(each.asked_at, self._failed_at)
                self._took[each.unit] = max(took, FADING * self._took.get(each.unit, 0.0))
            self.conclude(each, outcome, now)
        self.go_on()
