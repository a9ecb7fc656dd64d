"""
The times of polls, in seconds of any monotonic clock; and one connection, and the devices that
share it: each is polled when it is due.

The first request of a poll waits for its turn; the others come before those of other devices,
because the values of a poll should be read together. A poll of a device that is down is a trial.
"""

from __future__ import annotations

import asyncio
import errno
from collections.abc import Callable
from functools import partial
from hashlib import blake2b
from heapq import heappop, heappush
from typing import Any, Generic, TypeVar

from ...client.asynchronous import AsyncClient
from ...client.reconnecting import State
from ...ports.endpoint import Endpoint
from ...protocol.errors import ModbusConnectionError, ModbusError
from ..line import FairQueue, SharedLine
from .poller import DeviceState, Poller
from .statistics import FleetStatistics

__all__ = ["FleetLine", "MayAsk", "Timetable", "first_time", "next_time"]


MayAsk = Callable[[str], bool]


def first_time(name: str, interval: float, now: float, wall: float) -> float:
    """
    Return the first time of a device, `wall` being the time of day now, in seconds since the epoch.

    Its phase is derived from its name and the time of day, so that every machine polls it at the
    same moments, and thousands are never polled at once.
    """
    digest = blake2b(name.encode(), digest_size=8).digest()
    phase = int.from_bytes(digest, "big") / 2**64 * interval
    return now + (phase - wall) % interval


def next_time(planned: float, interval: float, now: float) -> tuple[float, int]:
    """Return the first time after now, and how many earlier times are skipped."""
    missed = max(0, int((now - planned) // interval))
    return planned + (missed + 1) * interval, missed


Each = TypeVar("Each")


class Timetable(Generic[Each]):
    """A priority queue of thousands of members by time; each has one place in it."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, Each]] = []
        self._places: dict[Each, int] = {}
        self._number = 0

    def __len__(self) -> int:
        return len(self._places)

    def put(self, each: Each, at: float) -> None:
        """Add a member, or move it to another time."""
        self._number += 1
        self._places[each] = self._number
        heappush(self._heap, (at, self._number, each))

    def remove(self, each: Each) -> None:
        """Remove a member, if it is there."""
        self._places.pop(each, None)
        if len(self._heap) > 2 * len(self._places) + 100:
            self._heap = [entry for entry in self._heap if self._places.get(entry[2]) == entry[1]]
            self._heap.sort()

    @property
    def next_at(self) -> float | None:
        """The earliest time; None without members."""
        heap = self._heap
        while heap and self._places.get(heap[0][2]) != heap[0][1]:
            heappop(heap)
        return heap[0][0] if heap else None

    def due(self, now: float, most: int) -> list[tuple[float, Each]]:
        """Remove and return up to `most` members that are due, with their times."""
        found: list[tuple[float, Each]] = []
        while self._heap and self._heap[0][0] <= now and len(found) < most:
            at, number, each = heappop(self._heap)
            if self._places.get(each) == number:
                del self._places[each]
                found.append((at, each))
        return found


class FleetLine(SharedLine[Poller]):
    """
    Polls the devices of one connection in the order in which they are due.

    A device that is down is tried when no other waits, one at a time; such a trial costs others no
    more than one of their own answers takes.

    Args:
        on_polled: called after each poll with the state before it; None if it was not sent.
        on_back: called with the devices that were down, once the connection is established again.
    """

    def __init__(
        self,
        key: str,
        endpoint: Endpoint,
        may_ask: MayAsk | None,
        statistics: FleetStatistics,
        on_polled: Callable[[Poller, DeviceState | None], None],
        on_back: Callable[[list[Poller]], None],
    ) -> None:
        self._is_gated = may_ask is not None
        gate = None if may_ask is None else partial(may_ask, key)
        client = AsyncClient(endpoint.url, may_send=gate, on_state=self._note_state)
        super().__init__(client, FairQueue, most_trials=1)
        self.url: str = endpoint.url
        self.pollers: dict[str, Poller] = {}
        self._clients: dict[float | None, AsyncClient] = {None: client}
        self._statistics = statistics
        self._on_polled = on_polled
        self._on_back = on_back
        self._resting: dict[Poller, asyncio.TimerHandle] = {}

    def add(self, poller: Poller) -> None:
        self.pollers[poller.name] = poller

    def withdraw_device(self, name: str) -> None:
        """Remove a device, and withdraw its request."""
        poller = self.pollers.pop(name)
        if (resting := self._resting.pop(poller, None)) is not None:
            resting.cancel()
        self.withdraw(poller)

    def client_of(self, each: Poller) -> AsyncClient:
        timeout = each.config.timeout
        client = self._clients.get(timeout)
        if client is None:
            client = self._clients[timeout] = self.client.for_unit(1, timeout=timeout)
        return client

    def stop(self) -> list[Poller]:
        waiting = super().stop()
        for resting in self._resting.values():
            resting.cancel()
        for poller in self.pollers.values():
            self.withdraw(poller)
        return waiting

    def due(self, poller: Poller, planned: float) -> None:
        """Poll a device, unless its last poll is still under way."""
        if poller.request is not None:
            self._statistics.skipped += 1
            return
        poller.is_urgent, poller.is_trial = False, poller.state is DeviceState.DOWN
        poller.begin(planned, self.client.statistics.connects)
        self._ask_after_rest(poller)

    def _ask_after_rest(self, poller: Poller) -> None:
        now = self._loop.time()
        if poller.rest_until > now:
            timer = self._loop.call_at(poller.rest_until, self._end_rest, poller)
            self._resting[poller] = timer
        else:
            self.ask(poller, now)

    def _end_rest(self, poller: Poller) -> None:
        del self._resting[poller]
        self.ask(poller, self._loop.time())

    def _send(self, each: Poller, now: float) -> None:
        if not each.is_urgent:
            self._statistics.note_start(max(0.0, now - each.waits_since))
        super()._send(each, now)

    def conclude(self, each: Poller, outcome: Any, now: float) -> None:
        """Pass the outcome of a request to its poll, which continues or is over."""
        # Requests that `may_ask` refused fail with EPERM.
        if self._is_gated and getattr(outcome, "errno", 0) == errno.EPERM:
            each.request = None
            self._statistics.held += 1
            self._on_polled(each, None)
            return
        before = each.state
        each.take(outcome, now)
        if each.request is None:
            self._on_polled(each, before)
        else:
            each.is_urgent = True
            self._ask_after_rest(each)

    def _note_state(self, state: State, error: ModbusError | None) -> None:
        if state is State.CONNECTED:
            lost = [
                each
                for each in self.pollers.values()
                if each.request is None
                and each.state is DeviceState.DOWN
                and isinstance(each.error, ModbusConnectionError)
            ]
            if lost:
                self._on_back(lost)
