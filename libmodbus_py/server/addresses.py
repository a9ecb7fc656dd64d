"""
Limits of addresses, and the order in which connections are idle.

A client that opens another connection is still the same client.
"""

from __future__ import annotations

import asyncio
import math
from collections import OrderedDict
from collections.abc import Iterator
from typing import Generic, Protocol, TypeVar

from .limits import Allowance, counted_host

__all__ = ["Address", "Addresses", "Idle", "Paused", "due"]

# The number of addresses without a connection that are remembered, so that they cannot evade
# their limit. It is bounded because a sender of datagrams can forge any number of addresses.
REMEMBERED_MAX = 4096

# Seconds that a resumed connection without a request delays the next one of its address.
LONGEST_TURN = 0.05


Connection = TypeVar("Connection")


class Idle(Generic[Connection]):
    """
    Connections in the order in which they are closed to make room: those that never
    sent a request, then the others; the longest idle first in each group.

    Attributes:
        strangers: connections without a request -> the time at which they came.
        known: the others -> the time of their last request.
    """

    __slots__ = ("known", "strangers")

    def __init__(self) -> None:
        self.strangers: dict[Connection, float] = {}
        self.known: dict[Connection, float] = {}

    def __len__(self) -> int:
        return len(self.strangers) + len(self.known)

    def __iter__(self) -> Iterator[Connection]:
        yield from self.strangers
        yield from self.known

    def add(self, each: Connection, now: float) -> None:
        self.strangers[each] = now

    def note_request(self, each: Connection, now: float) -> None:
        """Make a connection the latest of all."""
        self.remove(each)
        self.known[each] = now

    def remove(self, each: Connection) -> None:
        self.strangers.pop(each, None)
        self.known.pop(each, None)

    def due(self, until: float) -> list[Connection]:
        """Return the connections that have been idle since a time, or longer."""
        return [*due(self.strangers, until), *due(self.known, until)]


def due(times: dict[Connection, float], until: float) -> list[Connection]:
    """Return the first ones up to a time; the times are in order."""
    found = []
    for each, time in times.items():
        if time > until:
            break
        found.append(each)
    return found


class Paused(Protocol):
    """A connection that is not read while its address exceeds its limit of requests."""

    def resume(self) -> None: ...


Each = TypeVar("Each", bound=Paused)


class Address(Generic[Each]):
    """
    One address, and all its connections.

    Args:
        rate: the number of requests that are answered in a second.

    Attributes:
        host: the address, as `counted_host` returns it.
        idle: the connections of the address, in the order in which they became idle.
    """

    __slots__ = ("_allowance", "_loop", "_paused", "_rate", "_timer", "host", "idle")

    def __init__(self, host: str, rate: float, loop: asyncio.AbstractEventLoop) -> None:
        self.host: str = host
        self.idle: Idle[Each] = Idle()
        self._rate = rate
        self._loop = loop
        self._allowance = Allowance(rate, loop.time())
        self._paused: OrderedDict[Each, None] = OrderedDict()
        self._timer: asyncio.TimerHandle | None = None

    def is_overspent(self) -> bool:
        """Return True if the address has sent too many requests for now."""
        return self._allowance.wait(self._loop.time()) > 0

    def spend(self, requests: int) -> None:
        self._allowance.spend(requests)

    def pause(self, connection: Each) -> None:
        """Resume a connection in its turn, when its address may send requests again."""
        self._paused[connection] = None
        if self._timer is None:
            self._release_after(self._allowance.wait(self._loop.time()))

    def forget(self, connection: Each) -> None:
        self.idle.remove(connection)
        self._paused.pop(connection, None)
        if not self._paused and self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _release_after(self, seconds: float) -> None:
        self._timer = self._loop.call_later(seconds, self._release)

    def _release(self) -> None:
        """Resume one connection only, because its requests are counted after it is read."""
        self._timer = None
        wait = self._allowance.wait(self._loop.time())
        if not wait:
            connection, _ = self._paused.popitem(last=False)
            connection.resume()
            wait = min(1 / self._rate, LONGEST_TURN)
        if self._paused:
            self._release_after(wait)


class Addresses(Generic[Each]):
    """
    The connected addresses, and those that were connected most recently.

    Args:
        rate: the number of requests of each that are answered in a second; may be infinite.
    """

    def __init__(self, rate: float = math.inf) -> None:
        self._rate = rate
        self._loop = asyncio.get_running_loop()
        self._connected: dict[str, Address[Each]] = {}
        self._others: OrderedDict[str, Address[Each]] = OrderedDict()

    def get(self, host: str) -> Address[Each]:
        """Return an address, which is remembered only after `keep`."""
        host = counted_host(host)
        address = self._connected.get(host) or self._others.get(host)
        return address or Address(host, self._rate, self._loop)

    def keep(self, address: Address[Each]) -> None:
        """Remember an address while it has connections or is one of the latest."""
        if address.idle:
            self._connected[address.host] = address
            self._others.pop(address.host, None)
            return
        self._connected.pop(address.host, None)
        if self._rate == math.inf:  # nothing to remember
            return
        self._others[address.host] = address
        self._others.move_to_end(address.host)
        if len(self._others) > REMEMBERED_MAX:
            self._others.popitem(last=False)
