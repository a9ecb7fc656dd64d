"""
One connection, and the devices that share it: each is polled when it is due.

The first request of a poll waits for its turn; the others come before those of other devices,
because the values of a poll should be read together. A poll of a device that is down is a trial.
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
from ...protocol.errors import ModbusConnectionError, ModbusError
from ..line import FairQueue, SharedLine
from .poller import DeviceState, Poller
from .statistics import FleetStatistics

__all__ = ["FleetLine", "MayAsk"]

MayAsk = Callable[[str], bool]


class FleetLine(SharedLine[Poller]):
    """
    Polls the devices of one connection in the order in which they are due.

    A device that is down is tried when no other waits, one at a time; such a trial costs others no
    more than one of their own answers takes.

    Args:
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
        if self._is_gated and _was_held(outcome):
            each.request = None
            self._statistics.held += 1
            self._on_polled(each, False)
            return
        each.take(outcome, now)
        if each.request is None:
            self._on_polled(each, True)
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


def _was_held(outcome: Any) -> bool:
    """Return True if `may_ask` refused a request."""
    return isinstance(outcome, ModbusConnectionError) and outcome.errno == errno.EPERM
