"""
One connection, and the devices that share it.
"""

from __future__ import annotations

import asyncio
import errno
from collections.abc import Callable
from functools import partial
from typing import Any

from ...client.asynchronous import AsyncClient
from ...client.reconnecting import State
from ...ports.endpoint import Endpoint
from ...ports.waiting_async import Alarm
from ...protocol.errors import ModbusConnectionError, ModbusError, ModbusTimeoutError
from ..waiting_room import FirstCome, WaitingRoom
from .poller import DeviceState, Poller
from .statistics import FleetStatistics

__all__ = ["FleetLine", "MayAsk"]

MayAsk = Callable[[str], bool]


class FleetLine:
    """
    Polls the devices of one connection in the order in which they are due.

    A device that is down is tried when no other waits, one at a time; such a trial costs others
    no more than one of their own answers takes.

    Args:
        key: of the connection.
        endpoint: of the connection, with the options of its client.
        may_ask: as of `Fleet`.
        statistics: of the fleet.
        on_polled: called after each poll, and with False for a poll that was not sent.
        on_back: called with the devices that were down, once the connection is established again.
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
        client = AsyncClient(endpoint.url, may_send=gate, on_state=self._note_state)
        self.client: AsyncClient = client
        self._is_gated = gate is not None
        self._clients: dict[float | None, AsyncClient] = {None: self.client}
        self._loop = asyncio.get_running_loop()
        self._queue: FirstCome[Poller] = FirstCome()
        self._room: WaitingRoom[Poller] = WaitingRoom(
            lambda: client.room,
            self._queue,
            timeout=lambda poller: self.client_of(poller).timeout,
            ready_at=None if client.has_ids else self._ready_at,
            most_trials=1,
        )
        self._statistics = statistics
        self._on_polled = on_polled
        self._on_back = on_back
        self._resting: dict[Poller, asyncio.TimerHandle] = {}
        self._done: list[Poller] = []
        self._alarm = Alarm(self._go_on)
        self._is_closed = False

    # --- devices ------------------------------------------------------------------------------

    def add(self, poller: Poller) -> None:
        self.pollers[poller.name] = poller

    def remove(self, name: str) -> None:
        """Remove a device, and withdraw its request."""
        poller = self.pollers.pop(name)
        if poller.submitted is not None:
            self._withdraw(poller)
        self._room.remove(poller)
        resting = self._resting.pop(poller, None)
        if resting is not None:
            resting.cancel()
        # Not at once: the next one may be removed together with this one.
        self._loop.call_soon(self._go_on)

    def client_of(self, poller: Poller) -> AsyncClient:
        """Return a client with the timeout of a device."""
        timeout = poller.config.timeout
        client = self._clients.get(timeout)
        if client is None:
            client = self._clients[timeout] = self.client.for_unit(1, timeout=timeout)
        return client

    def stop(self) -> None:
        """Withdraw all requests, and send no more."""
        self._is_closed = True
        for poller in self.pollers.values():
            if poller.submitted is not None:
                self._withdraw(poller)
        self._alarm.cancel()
        for resting in self._resting.values():
            resting.cancel()
        self._resting.clear()
        self._room.clear()

    async def close(self) -> None:
        """Close the connection for good."""
        self.stop()
        await self.client.close()

    # --- polls --------------------------------------------------------------------------------

    def due(self, poller: Poller, planned: float) -> None:
        """Poll a device, unless its last poll is still under way."""
        if poller.planned is not None:
            self._statistics.skipped += 1
            return
        poller.planned = poller.waits_since = planned
        poller.is_trial = poller.state is DeviceState.DOWN
        now = self._loop.time()
        poller.begin(now, self.client.statistics.connects)
        if poller.rest_until > now:
            self._rest(poller)
        elif not (self._is_closed or poller.is_trial) and self._room.begin(poller, now):
            self._ask(poller, now)
        else:
            self._room.put(poller)
            self._go_on()

    def _rest(self, poller: Poller) -> None:
        pause = poller.rest_until - self._loop.time()
        self._resting[poller] = self._loop.call_later(pause, self._end_rest, poller)

    def _end_rest(self, poller: Poller) -> None:
        del self._resting[poller]
        self._room.put(poller)
        self._go_on()

    def _go_on(self) -> None:
        if self._is_closed:
            return
        now = self._loop.time()
        while (poller := self._room.pick(now)) is not None:
            self._room.start(poller)
            self._ask(poller, now)
        if self._room.trying and (trial := self._room.overstayed(now)) is not None:
            self._make_way(trial)
        if self._room.alarm < self._alarm.at:
            self._alarm.set(self._room.alarm, self._loop)

    def _ask(self, poller: Poller, now: float) -> None:
        if not poller.has_begun:
            assert poller.planned is not None
            self._statistics.note_start(max(0.0, now - poller.planned))
        poller.asked_at = now
        poller.submitted = self.client_of(poller).submit(
            poller.config.unit, poller.next_request, partial(self._note_done, poller)
        )

    def _ready_at(self, poller: Poller) -> float:
        return self.client.ready_at(poller.unit, poller.next_request.function)

    def _make_way(self, poller: Poller) -> None:
        assert poller.submitted is not None
        if poller.submitted.is_answered or poller in self._done:
            return
        self._withdraw(poller)
        self._conclude(poller, ModbusTimeoutError("no answer while others waited"))
        self._go_on()

    def _withdraw(self, poller: Poller) -> None:
        assert poller.submitted is not None
        if poller in self._done:
            self._done.remove(poller)
        else:
            poller.submitted.withdraw()
        self._end(poller)

    def _end(self, poller: Poller, took: float | None = None) -> None:
        poller.submitted = None
        self._room.end(poller, took)

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
            is_answer = not isinstance(outcome, BaseException)
            self._end(poller, now - poller.asked_at if is_answer else None)
            self._conclude(poller, outcome)
        self._go_on()

    def _conclude(self, poller: Poller, outcome: Any) -> None:
        """Pass the outcome of a request to its poll, which continues or is over."""
        if self._is_gated and _was_held(outcome):
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
        elif not poller.is_trial and self._room.begin(poller, now):
            self._ask(poller, now)
        else:
            self._queue.put_first(poller)  # the values of a poll should be read together

    def _note_state(self, state: State, error: ModbusError | None) -> None:
        if state is State.CONNECTED:
            lost = [
                poller
                for poller in self.pollers.values()
                if poller.state is DeviceState.DOWN
                and poller.planned is None
                and isinstance(poller.error, ModbusConnectionError)
            ]
            if lost:
                self._on_back(lost)


def _was_held(outcome: Any) -> bool:
    """Return True if `may_ask` refused a request."""
    return isinstance(outcome, ModbusConnectionError) and outcome.errno == errno.EPERM
