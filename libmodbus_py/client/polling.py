"""
Polls at a steady pace: the iterators that `watch` of both clients returns.

The n-th poll is due n intervals after the first one, so that the times do not drift. A poll that
is late, because the device or the program took longer, is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from math import ceil
from os import PathLike
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from .requests import Awaiting, Blocking

if TYPE_CHECKING:
    from ..maps.plan import Plan
    from ..maps.watched import WatchedPoints
    from .asyncio_driver import AsyncioDriver
    from .blocking_driver import BlockingDriver

__all__ = ["Driving", "Polls", "watched"]

Driving = TypeVar("Driving", bound="BlockingDriver | AsyncioDriver")
Values = TypeVar("Values")


class Polls(Generic[Driving, Values]):
    """
    An endless iterator over the values of a device, made by `watch`: for ``for`` with a blocking
    client, for ``async for`` with an `AsyncClient`.

    It ends when the client is closed, which of a blocking client any thread and signal handlers may
    do. It holds no resources between two values, so that a loop over it may be left at any time;
    waiting for the next values may be cancelled and started again.
    """

    def __init__(self, client: Any, interval: float, poll: Callable[[float], Any]) -> None:
        self._client = client
        self._driver: Any = client._driver
        self._interval = interval
        self._begun: float | None = None
        self._polls = 0
        self._poll = poll

    def _due(self) -> float:
        """Return when the next poll is due."""
        now: float = self._driver.now()
        if self._begun is None:
            return now
        first_not_missed = ceil((now - self._begun) / self._interval)
        return self._begun + max(self._polls, first_not_missed) * self._interval

    def _begin(self, due: float) -> Any:
        """Begin the poll of this time."""
        if self._begun is None:
            self._begun = due
        self._polls = round((due - self._begun) / self._interval) + 1
        return self._poll(due)

    def __iter__(self: Polls[BlockingDriver, Values]) -> Polls[BlockingDriver, Values]:
        return self

    def __next__(self: Polls[BlockingDriver, Values]) -> Values:
        if isinstance(self._client, Awaiting):
            raise TypeError("watch of an AsyncClient is for async for")
        due = self._due()
        if not self._driver.wait_until(due):
            raise StopIteration
        values: Values = self._begin(due)
        if self._client.closed:
            raise StopIteration
        return values

    def __aiter__(self: Polls[AsyncioDriver, Values]) -> Polls[AsyncioDriver, Values]:
        return self

    async def __anext__(self: Polls[AsyncioDriver, Values]) -> Values:
        if isinstance(self._client, Blocking):
            raise TypeError("watch of a blocking client is for a plain for, not async for")
        due = self._due()
        if not await self._driver.wait_until(due):
            raise StopAsyncIteration
        values: Values = await self._begin(due)
        if self._client.closed:
            raise StopAsyncIteration
        return values


def watched(what: Any, names: Any, every: float, options: Any) -> WatchedPoints | Plan:
    """Return what is polled; raise TypeError or ValueError as `RegisterMap.plan` and `Plan` do."""
    from ..maps.plan import planned
    from ..maps.register_map import RegisterMap, map_of

    if isinstance(what, RegisterMap | str | PathLike):
        from ..maps.watched import WatchedPoints

        return WatchedPoints(map_of(what), names, every, **options)
    if names is not None:
        raise ValueError("names are for a RegisterMap only")
    return planned(what, options)
