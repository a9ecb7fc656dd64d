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
from ..client.sender import Sender, SubmittedRequest
from ..ports.waiting import Alarm
from ..protocol.errors import ExceptionResponse, ModbusTimeoutError

SHORTEST_TRIAL_S = 0.02
"""The least time of a trial that others wait for: a few requests of a fast line."""

FADING = 0.95  # the share of a unit's longest response time that is kept with each further answer
TRIALS_BEFORE_LONG = 16  # one trial of a unit in so many has its whole timeout
MOST_DOUBLINGS = 20  # the most doublings of a pause, so that no number grows without bound


def pause_after(misses: int, first: float, longest: float) -> float:
    """Return the seconds for which a unit is paused after so many misses in a row, 1 or more."""
    pause: float = first * 2 ** min(misses - 1, MOST_DOUBLINGS)
    return min(pause, max(longest, first))


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
        self.submitted: SubmittedRequest | None = None  # while it is in flight


Job = TypeVar("Job", bound=LineRequest)


class FairQueue(Generic[Job]):
    """Requests that wait: hosts take turns, within each its clients, which keep their order."""

    def __init__(self, most_of_client: float = math.inf, most: float = math.inf) -> None:
        self._most_of_client = most_of_client
        self._most = most
        # The host, and within it the client, whose turn is next is first.
        self._hosts: dict[Hashable, dict[Hashable, deque[Job]]] = {}
        self.count: int = 0

    def __iter__(self) -> Iterator[Job]:
        return (job for host in self._hosts.values() for queue in host.values() for job in queue)

    def put(self, job: Job) -> bool:
        """Add a request; return False if too many wait."""
        clients = self._hosts.get(job.host, {})
        queue = clients.get(job.client, deque())
        if self.count >= self._most or len(queue) >= self._most_of_client:
            return False
        queue.append(job)
        self._hosts[job.host] = clients
        clients[job.client] = queue
        self.count += 1
        return True

    def pick(self, may_ask: Callable[[Job], bool]) -> Job | None:
        """Remove and return the first request that may be asked now; None if none may."""
        job = next(filter(may_ask, self), None)
        if job is not None:
            self.remove(job)
            if clients := self._hosts.pop(job.host, None):
                self._hosts[job.host] = clients
                if queue := clients.pop(job.client, None):
                    clients[job.client] = queue
        return job

    def remove(self, job: Job) -> bool:
        """Remove a request; return False if it does not wait here."""
        clients = self._hosts.get(job.host, {})
        queue = clients.get(job.client, deque())
        if job not in queue:
            return False
        queue.remove(job)
        self.count -= 1
        if not queue:
            del clients[job.client]
            if not clients:
                del self._hosts[job.host]
        return True


class SharedLine(ABC, Generic[Job]):
    """One connection, and the requests that share it; trials may wait for any time."""

    def __init__(
        self,
        sender: Sender,
        make_queue: Callable[[], FairQueue[Job]],
        *,
        longest_wait: float = math.inf,
        most_trials: float = math.inf,
    ) -> None:
        self.client: AsyncClient = sender.client
        self.sender: Sender = sender
        self.in_flight: dict[Job, None] = {}  # in the order in which they were sent
        self.is_closed: bool = False
        self._loop = asyncio.get_running_loop()
        self._has_ids = sender.has_ids
        self._longest_wait = longest_wait
        self._most_trials = most_trials
        self._urgent, self._usual = make_queue(), make_queue()
        self._trials: FairQueue[Job] = FairQueue()
        self._open_trials: dict[Job, None] = {}  # the trials in flight, in their order
        self._was_trial = False  # the request that was sent last
        # Unit -> the longest time that its answers took, fading.
        self._took: dict[int, float] = {}
        self._failed_at = 0.0
        self._done: list[Job] = []
        self._alarm = Alarm(self.go_on)
        self._next_at = math.inf

    # --- decisions of subclasses --------------------------------------------------------------

    @abstractmethod
    def conclude(self, job: Job, outcome: Any, now: float) -> None:
        """Take the outcome of a request: its result, or an exception."""

    def sender_of(self, job: Job) -> Sender:
        """Return what sends a request, with the timeout of the request."""
        return self.sender

    def give_up(self, job: Job, now: float) -> None:
        """Conclude a trial that was stopped for other requests."""
        self.conclude(job, ModbusTimeoutError("no answer while others waited"), now)

    def expire(self, job: Job, now: float) -> None:
        """Conclude a request that waited for too long, and was not sent."""
        self.conclude(job, ModbusTimeoutError("not sent: others took too long"), now)

    # --- requests -----------------------------------------------------------------------------

    @property
    def waiting(self) -> int:
        """The number of requests that wait, trials excepted."""
        return self._urgent.count + self._usual.count

    def others(self) -> list[Job]:
        """Return the requests that wait, trials excepted."""
        return [*self._urgent, *self._usual]

    def ask(self, job: Job, now: float) -> bool:
        """Send a request now, or when it is its turn; return False if too many wait."""
        is_next = not (job.is_trial or self.is_closed or self._trials.count or self.waiting)
        if is_next and not self._is_full() and self._ready_at(job) <= now:
            self._send(job, now)
            return True
        queue = self._trials if job.is_trial else self._usual
        if not (self._urgent if job.is_urgent else queue).put(job):
            return False
        self.go_on()
        return True

    def drop(self, job: Job) -> bool:
        """Do not send a request; return False if it was sent already, or is over."""
        if job.submitted is None:
            if not self.remove(job):
                return False
        elif job.submitted.send_no_more():
            self._end(job)
        else:
            return False
        self._go_on_soon()
        return True

    def withdraw(self, job: Job) -> None:
        """Forget a request, in whatever state it is."""
        if job.submitted is None:
            self.remove(job)
        else:
            if job in self._done:
                self._done.remove(job)
            else:
                job.submitted.withdraw()
            self._end(job)
        self._go_on_soon()

    def remove(self, job: Job) -> bool:
        return any(queue.remove(job) for queue in (self._urgent, self._usual, self._trials))

    def stop(self) -> list[Job]:
        """Send nothing any more; remove and return all requests that wait."""
        self.is_closed = True
        self._alarm.cancel()
        waiting = [*self.others(), *self._trials]
        for job in waiting:
            self.remove(job)
        return waiting

    async def close(self) -> None:
        """Close the connection for good; requests in flight are concluded with its error."""
        self.stop()
        await self.client.close()
        self._finish()

    # --- the next request ---------------------------------------------------------------------

    def go_on(self, now: float | None = None) -> None:
        """
        Send what may be sent now, or at the time that the alarm was set for, and set it for the
        rest.
        """
        if self.is_closed:
            return
        now = self._loop.time() if now is None else now
        while (job := self._pick(now)) is not None:
            if job.is_trial or now - job.waits_since <= self._longest_wait:
                self._send(job, now)
            else:
                self.expire(job, now)
        if self._open_trials:
            self._end_overstayed(now)
        if self._next_at < self._alarm.at:
            self._alarm.set(self._next_at, self._loop)

    def _is_full(self) -> bool:
        return bool(self.in_flight) and len(self.in_flight) >= self.sender.room

    def _ready_at(self, job: Job) -> float:
        if self._has_ids:
            return 0.0
        return self.sender.ready_at(job.unit, job.request.function)

    def _pick(self, now: float) -> Job | None:
        """Remove and return the request to send now; None if none may be."""
        self._next_at = math.inf
        if not (self._trials.count or self.waiting) or self._is_full():
            return None

        def may_ask(candidate: Job) -> bool:
            at = self._ready_at(candidate)
            if at > now:
                self._next_at = min(self._next_at, at)
            return at <= now

        job = self._trials.pick(may_ask) if self._is_trial_due(now) else None
        job = job or self._urgent.pick(may_ask) or self._usual.pick(may_ask)
        if job is None and len(self._open_trials) < self._most_trials:
            job = self._trials.pick(may_ask)
        return job

    def _is_trial_due(self, now: float) -> bool:
        """Return True if a trial is to be sent before others, which wait."""
        first = next(iter(self._trials), None)
        if first is None or self._open_trials or self._was_trial:
            return False
        return now - first.waits_since >= self.sender_of(first).client.timeout

    def _end_overstayed(self, now: float) -> None:
        """End a trial that others have waited for, for long enough."""
        job = next((job for job in self._open_trials if job.misses % TRIALS_BEFORE_LONG), None)
        if job is None or not self.waiting or not self._is_full():
            return
        took = max([SHORTEST_TRIAL_S, *self._took.values()])
        until = job.asked_at + min(self.sender_of(job).client.timeout, took)
        if until > now:
            self._next_at = min(self._next_at, until)
            return
        assert job.submitted is not None
        if not (job.submitted.is_answered or job in self._done):
            job.submitted.withdraw()
            self._end(job)
            self.give_up(job, now)
            self.go_on()

    # --- in flight ----------------------------------------------------------------------------

    def _send(self, job: Job, now: float) -> None:
        self.in_flight[job] = None
        self._was_trial = job.is_trial
        if job.is_trial:
            self._open_trials[job] = None
        job.asked_at = now
        job.submitted = self.sender_of(job).submit(
            job.unit, job.request, partial(self._note_done, job)
        )

    def _end(self, job: Job) -> None:
        job.submitted = None
        del self.in_flight[job]
        self._open_trials.pop(job, None)

    def _note_done(self, job: Job) -> None:
        self._go_on_soon()
        self._done.append(job)

    def _go_on_soon(self) -> None:
        if not self._done:
            self._loop.call_soon(self._finish)

    def _finish(self) -> None:
        """Conclude the requests that are done, all at once, and send the next ones."""
        jobs, self._done = self._done, []
        now = self._loop.time()
        for job in jobs:
            if job.submitted is None:  # withdrawn because of what was concluded before
                continue
            outcome: Any = job.submitted.outcome
            self._end(job)
            if isinstance(outcome, BaseException) and not isinstance(outcome, ExceptionResponse):
                self._failed_at = now
            elif outcome is not None:
                # It may have been sent after one that failed.
                took = now - max(job.asked_at, self._failed_at)
                self._took[job.unit] = max(took, FADING * self._took.get(job.unit, 0.0))
            self.conclude(job, outcome, now)
        self.go_on()
