"""
The order of requests on a shared connection: no socket, no clock.

A discipline decides in which order requests are asked: `FirstCome`, or `FairByHost`. The
`WaitingRoom` adds rules for all connections: the number of requests in flight, the time at which a
silent unit is tried again, and the delay that such a trial may cause for others.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Sequence
from itertools import chain
from typing import Generic, Protocol, TypeVar

__all__ = ["Discipline", "FairByHost", "FirstCome", "Precedence", "WaitingRoom", "rest_after"]

# The least delay that a trial may cause for others, in seconds: a few requests of a fast line.
SHORTEST_TRIAL = 0.02

# The share of the longest response time that is kept with each further answer.
FADING = 0.95

# One of so many trials of a unit waits for its whole timeout, even if others wait: the unit may
# have become slower than all others.
TRIALS_BEFORE_LONG = 16

# After so many doublings, every rest is the longest one.
MOST_DOUBLINGS = 20


def rest_after(misses: int, first: float, longest: float) -> float:
    """
    Return how many seconds a unit is left alone that gave no answer so many times in a row.

    Args:
        misses: 1 or more.
        first: the rest after one; it is doubled for each further one.
        longest: the longest rest, unless `first` is longer.
    """
    rest: float = first * 2 ** min(misses - 1, MOST_DOUBLINGS)
    return min(rest, max(longest, first))


class Waiting(Hashable, Protocol):
    """
    A request that waits, or is in flight.

    Attributes:
        unit: the unit of the request.
        is_trial: True if the unit did not answer the previous request.
        misses: the number of requests in a row that the unit did not answer.
        waits_since: the time since which the request waits.
        asked_at: the time at which it was sent.
    """

    @property
    def unit(self) -> Hashable: ...
    @property
    def is_trial(self) -> bool: ...
    @property
    def misses(self) -> int: ...
    @property
    def waits_since(self) -> float: ...
    @property
    def asked_at(self) -> float: ...


class FromHost(Protocol):
    """A request of a client; all clients of one host share the turns of the host."""

    @property
    def host(self) -> Hashable: ...
    @property
    def client(self) -> Hashable: ...


Each = TypeVar("Each")
Member = TypeVar("Member", bound=Waiting)
Guest = TypeVar("Guest", bound=FromHost)

MayAsk = Callable[[Each], bool]


class Discipline(Protocol[Each]):
    """
    The requests that wait for a connection, in the order in which they are asked.

    Attributes:
        waiting: True, as a bool, if a request waits.
    """

    @property
    def waiting(self) -> object: ...

    def __iter__(self) -> Iterator[Each]: ...

    def has(self, each: Each) -> bool:
        """Return True if a request waits."""
        ...

    def put(self, each: Each) -> bool:
        """Add a request; return False if too many wait."""
        ...

    def pick(self, may_ask: MayAsk[Each] | None) -> Each | None:
        """Remove and return the first request that may be asked now; None if none may."""
        ...

    def remove(self, each: Each) -> None:
        """Remove a request that waits."""
        ...


class FirstCome(Generic[Each]):
    """Requests are asked in the order in which they came."""

    def __init__(self) -> None:
        self.waiting: deque[Each] = deque()

    def __iter__(self) -> Iterator[Each]:
        return iter(self.waiting)

    def has(self, each: Each) -> bool:
        return each in self.waiting

    def put(self, each: Each) -> bool:
        self.waiting.append(each)
        return True

    def put_first(self, each: Each) -> None:
        """Add a request that is asked before all others."""
        self.waiting.appendleft(each)

    def pick(self, may_ask: MayAsk[Each] | None = None) -> Each | None:
        for each in self.waiting:
            if may_ask is None or may_ask(each):
                self.waiting.remove(each)
                return each
        return None

    def remove(self, each: Each) -> None:
        self.waiting.remove(each)


class FairByHost(Generic[Guest]):
    """
    Hosts take turns, within each host its clients, and the requests of each client are asked in
    their order.

    Args:
        most_of_client: how many requests of one client may wait.
        most: how many in all.
    """

    def __init__(self, most_of_client: int, most: int) -> None:
        self._most_of_client = most_of_client
        self._most = most
        # The host, and within it the client, whose turn is next is first.
        self.waiting: dict[Hashable, dict[Hashable, deque[Guest]]] = {}
        self._count = 0

    def __iter__(self) -> Iterator[Guest]:
        return (
            each for queues in self.waiting.values() for queue in queues.values() for each in queue
        )

    def has(self, each: Guest) -> bool:
        return each in self.waiting.get(each.host, {}).get(each.client, ())

    def put(self, each: Guest) -> bool:
        if self._count >= self._most:
            return False
        queues = self.waiting.get(each.host)
        if queues is None:
            queues = self.waiting[each.host] = {}
        queue = queues.get(each.client)
        if queue is None:
            queue = queues[each.client] = deque()
        elif len(queue) >= self._most_of_client:
            return False
        queue.append(each)
        self._count += 1
        return True

    def pick(self, may_ask: MayAsk[Guest] | None = None) -> Guest | None:
        for queues in self.waiting.values():
            for queue in queues.values():
                for each in queue:
                    if may_ask is None or may_ask(each):
                        self.remove(each)
                        self._end_turn(each)
                        return each
        return None

    def remove(self, each: Guest) -> None:
        queues = self.waiting[each.host]
        queue = queues[each.client]
        if queue[0] is each:
            queue.popleft()
        else:
            queue.remove(each)
        self._count -= 1
        if not queue:
            del queues[each.client]
            if not queues:
                del self.waiting[each.host]

    def _end_turn(self, each: Guest) -> None:
        queues = self.waiting.get(each.host)
        if queues is None:
            return
        if each.client in queues:
            queues[each.client] = queues.pop(each.client)
        self.waiting[each.host] = self.waiting.pop(each.host)


class Precedence(Generic[Each]):
    """
    Several queues: a request of one is asked when those before it have none that may be.

    Args:
        queues: in their order.
        place: called with a request; returns the index of its queue.
    """

    def __init__(self, queues: Sequence[Discipline[Each]], place: Callable[[Each], int]) -> None:
        self._queues = queues
        self._place = place

    @property
    def waiting(self) -> bool:
        return any(queue.waiting for queue in self._queues)

    def __iter__(self) -> Iterator[Each]:
        return chain.from_iterable(self._queues)

    def has(self, each: Each) -> bool:
        return self._queues[self._place(each)].has(each)

    def put(self, each: Each) -> bool:
        return self._queues[self._place(each)].put(each)

    def pick(self, may_ask: MayAsk[Each] | None = None) -> Each | None:
        picked = (queue.pick(may_ask) for queue in self._queues)
        return next((each for each in picked if each is not None), None)

    def remove(self, each: Each) -> None:
        self._queues[self._place(each)].remove(each)


class WaitingRoom(Generic[Member]):
    """
    The requests for one connection, those that try a silent unit apart.

    A trial is made when no other request waits; when that never happens, after one timeout, but
    no two in a row. It makes way when others wait for longer than one of their own answers takes.

    Args:
        limit: called while requests are in flight; returns how many may be now.
        queue: those that wait, trials excepted.
        timeout: called with a request; returns the seconds that it may take.
        ready_at: called with a request; returns when it may be asked. None if any may be asked at
            any time.
        most_trials: how many trials may be in flight; None for as many as requests.

    Attributes:
        in_flight: how many requests are.
        trying: the trials in flight, in their order.
        alarm: when `pick` and `overstayed` should be called again; infinite if something else
            must happen first.
    """

    def __init__(
        self,
        limit: Callable[[], int],
        queue: Discipline[Member],
        timeout: Callable[[Member], float],
        ready_at: Callable[[Member], float] | None = None,
        most_trials: int | None = None,
    ) -> None:
        self.in_flight: int = 0
        self.alarm: float = math.inf
        self._limit = limit
        self._queue = queue
        self._timeout = timeout
        self._ready_at = ready_at
        self._most_trials = most_trials
        self._now: float  # of the last `pick`
        self._trials: deque[Member] = deque()
        self.trying: dict[Member, None] = {}
        self._was_trial = False
        # The longest times that answers took, fading: of all units, and of each.
        self._slowest = 0.0
        self._took: dict[Hashable, float] = {}

    @property
    def others(self) -> list[Member]:
        """The requests that wait, trials excepted."""
        return list(self._queue)

    def put(self, each: Member) -> bool:
        """Add a request; return False if too many wait."""
        if not each.is_trial:
            return self._queue.put(each)
        self._trials.append(each)
        return True

    def begin(self, each: Member, now: float) -> bool:
        """Start a new request that is not a trial at once; return False if it must wait."""
        if self._queue.waiting or self._trials or self._is_full():
            return False
        if self._ready_at is not None and self._ready_at(each) > now:
            return False
        self.in_flight += 1
        self._was_trial = False
        return True

    def remove(self, each: Member) -> bool:
        """Remove a request; return False if it does not wait."""
        if each in self._trials:
            self._trials.remove(each)
        elif self._queue.has(each):
            self._queue.remove(each)
        else:
            return False
        return True

    def clear(self) -> list[Member]:
        """Remove and return all requests that wait."""
        waiting = [*self._queue, *self._trials]
        for each in waiting:
            self.remove(each)
        return waiting

    # --- who is next --------------------------------------------------------------------------

    def pick(self, now: float) -> Member | None:
        """Remove and return the request to ask now; None if none may be."""
        self.alarm = math.inf
        if not (self._trials or self._queue.waiting) or self._is_full():
            return None
        self._now = now
        each = self._pick_trial(is_due=True) if self._trials else None
        if each is None:
            each = self._queue.pick(None if self._ready_at is None else self._may_ask)
        if each is None and self._trials:
            each = self._pick_trial(is_due=False)
        return each

    def _is_full(self) -> bool:
        return self.in_flight > 0 and self.in_flight >= self._limit()

    def _may_ask(self, each: Member) -> bool:
        at = 0.0 if self._ready_at is None else self._ready_at(each)
        if at <= self._now:
            return True
        self.alarm = min(self.alarm, at)
        return False

    def _pick_trial(self, *, is_due: bool) -> Member | None:
        """
        Remove and return the first trial that may be made.

        Args:
            is_due: True for one that has waited for a timeout, while others wait.
        """
        if is_due:
            first = self._trials[0]
            if self._was_trial or self._now - first.waits_since < self._timeout(first):
                return None
        most = 1 if is_due else self._most_trials
        if most is not None and len(self.trying) >= most:
            return None
        each = next((each for each in self._trials if self._may_ask(each)), None)
        if each is not None:
            self._trials.remove(each)
        return each

    def start(self, each: Member) -> None:
        """Note that a request that was picked is in flight."""
        self.in_flight += 1
        self._was_trial = each.is_trial
        if each.is_trial:
            self.trying[each] = None

    def end(self, each: Member, took: float | None = None) -> None:
        """Note that a request is over; `took`, if it was answered, says after how many seconds."""
        self.in_flight -= 1
        self.trying.pop(each, None)
        if took is not None:
            unit = each.unit
            self._slowest = max(took, FADING * self._slowest)
            self._took[unit] = max(took, FADING * self._took.get(unit, 0.0))

    def overstayed(self, now: float) -> Member | None:
        """Return a trial that must make way now, because others wait; None if none must."""
        if not self.trying or not self._queue.waiting or not self._is_full():
            return None
        each = next((each for each in self.trying if each.misses % TRIALS_BEFORE_LONG), None)
        if each is None:
            return None
        took = max(self._slowest, self._took.get(each.unit, 0.0), SHORTEST_TRIAL)
        until = each.asked_at + min(self._timeout(each), took)
        if until > now:
            self.alarm = min(self.alarm, until)
            return None
        return each
