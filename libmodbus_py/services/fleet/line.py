"""
One connection, and the devices that share it: whose poll is next.
"""

from __future__ import annotations

import asyncio
import errno
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

from ...client.asynchronous import IN_FLIGHT, AsyncClient
from ...client.reconnecting import State
from ...ports.endpoint import Endpoint
from ...protocol.errors import ModbusConnectionError, ModbusError, ModbusTimeoutError
from ...server.forking import abandoned_in_children
from .poller import Poller, Standing
from .statistics import FleetStatistics

__all__ = ["Line", "MayAsk"]

MayAsk = Callable[[str], bool]

# What a try of a silent device may cost others at least: a few turns of a fast line.
SHORTEST_TRY = 0.02

# How much of the longest time that an answer took counts when the next one came.
FADING = 0.95

# Of so many tries of a silent device one waits to the end, whoever waits for the line: it may
# have become slower than all others.
TRIES_BEFORE_LONG = 16


class Line:
    """
    Polls the devices of one connection in the order in which they are due.

    A device that is down is tried when no other waits, one at a time, and such a try makes way:
    it costs others no more than one of their own answers takes.

    Args:
        key: of the connection.
        endpoint: where it leads, with the options of its client.
        may_ask: as of `Fleet`.
        statistics: of the fleet.
        on_polled: told of each poll that is over; not of those that were not sent.
        on_back: told of the devices that may be there again, as the connection is.
    """

    def __init__(
        self,
        key: str,
        endpoint: Endpoint,
        may_ask: MayAsk | None,
        statistics: FleetStatistics,
        on_polled: Callable[[Poller, bool], None],
        on_back: Callable[[list[Poller]], None],
    ) -> None:
        self.key: str = key
        self.url: str = endpoint.url
        self.pollers: dict[str, Poller] = {}
        gate = None if may_ask is None else partial(may_ask, key)
        self.client: AsyncClient = AsyncClient(
            endpoint.url, may_send=gate, on_state=self._note_state
        )
        self._is_gated = gate is not None
        self._clients: dict[float | None, AsyncClient] = {None: self.client}
        self._loop = asyncio.get_running_loop()
        has_ids = endpoint.framing in ("tcp", "udp")
        options = endpoint.client_options
        self._limit: int = (options.get("max_in_flight") or IN_FLIGHT) if has_ids else 1
        self._statistics = statistics
        self._on_polled = on_polled
        self._on_back = on_back
        self._waiting: deque[Poller] = deque()
        self._tries: deque[Poller] = deque()
        self._trying: Poller | None = None
        self._resting: dict[Poller, asyncio.TimerHandle] = {}
        self._done: list[Poller] = []
        self._in_flight = 0
        self._was_try = False
        self._took = 0.0
        self._timer: asyncio.TimerHandle | None = None
        self._is_closed = False
        abandoned_in_children(self)

    # --- devices ------------------------------------------------------------------------------

    def add(self, poller: Poller) -> None:
        self.pollers[poller.name] = poller

    def remove(self, name: str) -> Poller:
        """Nothing more is asked of it."""
        poller = self.pollers.pop(name)
        if poller.submitted is not None:
            self._withdraw(poller)
        for queue in (self._waiting, self._tries):
            if poller in queue:
                queue.remove(poller)
        resting = self._resting.pop(poller, None)
        if resting is not None:
            resting.cancel()
        self._go_on()
        return poller

    def client_of(self, poller: Poller) -> AsyncClient:
        """Give what asks it, as long as it may take."""
        timeout = poller.config.timeout
        client = self._clients.get(timeout)
        if client is None:
            client = self._clients[timeout] = self.client.for_unit(1, timeout=timeout)
        return client

    def stop(self) -> None:
        """Nothing more is asked."""
        self._is_closed = True
        for poller in self.pollers.values():
            if poller.submitted is not None:
                self._withdraw(poller)
        if self._timer is not None:
            self._timer.cancel()
        for resting in self._resting.values():
            resting.cancel()
        self._resting.clear()
        self._waiting.clear()
        self._tries.clear()

    async def close(self) -> None:
        """For good."""
        self.stop()
        await self.client.close()

    def abandon(self) -> None:
        self.client.abandon()

    # --- polls --------------------------------------------------------------------------------

    def due(self, poller: Poller, planned: float) -> None:
        """Have it polled, unless it still is."""
        if poller.planned is not None:
            self._statistics.skipped += 1
            return
        poller.planned = planned
        poller.is_trial = poller.standing is Standing.DOWN
        poller.begin()
        if poller.rest_until > self._loop.time():
            self._rest(poller)
        else:
            self._enqueue(poller)
            self._go_on()

    def _enqueue(self, poller: Poller) -> None:
        (self._tries if poller.is_trial else self._waiting).append(poller)

    def _rest(self, poller: Poller) -> None:
        pause = poller.rest_until - self._loop.time()
        self._resting[poller] = self._loop.call_later(pause, self._end_rest, poller)

    def _end_rest(self, poller: Poller) -> None:
        del self._resting[poller]
        self._enqueue(poller)
        self._go_on()

    def _go_on(self) -> None:
        if self._is_closed:
            return
        while self._in_flight < self._limit and (poller := self._next()) is not None:
            self._ask(poller)
        if self._trying is not None and self._waiting and self._in_flight >= self._limit:
            self._make_way(self._trying)

    def _next(self) -> Poller | None:
        """Silent devices are tried when nobody else waits, or when that never happens."""
        if self._tries and self._trying is None:
            planned = self._tries[0].planned or 0.0
            has_waited = self._loop.time() - planned >= self.client.timeout
            if not self._waiting or (has_waited and not self._was_try):
                return self._tries.popleft()
        return self._waiting.popleft() if self._waiting else None

    def _ask(self, poller: Poller) -> None:
        now = self._loop.time()
        if not poller.has_begun:
            assert poller.planned is not None
            self._statistics.note_start(max(0.0, now - poller.planned))
        self._was_try = poller.is_trial
        if poller.is_trial:
            self._trying = poller
        self._in_flight += 1
        poller.asked_at = now
        poller.submitted = self.client_of(poller).submit(
            poller.config.unit, poller.next_request, partial(self._note_done, poller)
        )

    def _make_way(self, poller: Poller) -> None:
        if poller.misses % TRIES_BEFORE_LONG == 0 or poller in self._done:
            return
        patience = min(self.client_of(poller).timeout, max(self._took, poller.took, SHORTEST_TRY))
        wait = poller.asked_at + patience - self._loop.time()
        if wait > 0:
            if self._timer is None:
                self._timer = self._loop.call_later(wait, self._awake)
            return
        self._withdraw(poller)
        self._conclude(poller, ModbusTimeoutError("no answer while others waited"))
        self._go_on()

    def _awake(self) -> None:
        self._timer = None
        self._go_on()

    def _withdraw(self, poller: Poller) -> None:
        assert poller.submitted is not None
        if poller in self._done:
            self._done.remove(poller)
        else:
            poller.submitted.withdraw()
        self._end(poller)

    def _end(self, poller: Poller) -> None:
        poller.submitted = None
        self._in_flight -= 1
        if self._trying is poller:
            self._trying = None

    def _note_done(self, poller: Poller) -> None:
        if not self._done:
            self._loop.call_soon(self._finish)
        self._done.append(poller)

    def _finish(self) -> None:
        done, self._done = self._done, []
        now = self._loop.time()
        for poller in done:
            assert poller.submitted is not None
            outcome = poller.submitted.outcome
            self._end(poller)
            if not isinstance(outcome, BaseException):
                poller.took = max(now - poller.asked_at, FADING * poller.took)
                self._took = max(poller.took, FADING * self._took)
            self._conclude(poller, outcome)
        self._go_on()

    def _conclude(self, poller: Poller, outcome: Any) -> None:
        """Take what came of a request; its poll goes on, or is over."""
        if self._was_held(outcome):
            poller.planned = None
            self._statistics.held += 1
            self._on_polled(poller, False)
            return
        poller.take(outcome)
        now = self._loop.time()
        if poller.next_request is None:
            poller.planned = None
            poller.conclude(now)
            self._on_polled(poller, True)
        elif poller.config.spacing:
            poller.rest_until = now + poller.config.spacing
            self._rest(poller)
        else:
            self._waiting.appendleft(poller)  # all of a poll should be of one moment

    def _was_held(self, outcome: Any) -> bool:
        is_lost = isinstance(outcome, ModbusConnectionError)
        return self._is_gated and is_lost and outcome.errno == errno.EPERM

    def _note_state(self, state: State, error: ModbusError | None) -> None:
        if state is State.CONNECTED:
            lost = [
                poller
                for poller in self.pollers.values()
                if poller.standing is Standing.DOWN
                and poller.planned is None
                and isinstance(poller.error, ModbusConnectionError)
            ]
            if lost:
                self._on_back(lost)
