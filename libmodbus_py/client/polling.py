"""
Polls at a steady pace: the iterators that `watch` of both clients returns.

The n-th poll is due n intervals after the first one, so that the times do not drift. A poll that
is late, because the device or the program took longer, is left out.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from math import ceil
from os import PathLike
from typing import TYPE_CHECKING, Any, Generic, TypeVar

if TYPE_CHECKING:
    import asyncio

    from ..maps.plan import Plan
    from ..maps.watched import WatchedPoints

__all__ = ["AwaitedPolls", "PollWaits", "Polls", "interval_of", "watched"]

Values = TypeVar("Values")


class Schedule:
    """
    The times of polls.

    Args:
        interval: seconds.
    """

    def __init__(self, interval: float) -> None:
        self._interval = interval
        self._begun: float | None = None
        self._polls = 0

    def due(self, now: float) -> float:
        """Return when the next poll is due."""
        if self._begun is None:
            return now
        first_not_missed = ceil((now - self._begun) / self._interval)
        return self._begun + max(self._polls, first_not_missed) * self._interval

    def polled(self, due: float) -> None:
        """Note that the poll of this time takes place."""
        if self._begun is None:
            self._begun = due
        self._polls = round((due - self._begun) / self._interval) + 1


class PollWaits:
    """The waits of an event loop between polls, which all end when the client is closed."""

    def __init__(self) -> None:
        self._waits: set[asyncio.Future[None]] = set()

    async def until(self, at: float, loop: asyncio.AbstractEventLoop) -> None:
        """Wait until a time of the loop, or until `end`."""
        if at <= loop.time():
            return
        wait = loop.create_future()
        timer = loop.call_at(at, _end, wait)
        self._waits.add(wait)
        try:
            await wait
        finally:
            self._waits.discard(wait)
            timer.cancel()

    def end(self) -> None:
        for wait in self._waits:
            _end(wait)


def _end(wait: asyncio.Future[None]) -> None:
    if not wait.done():
        wait.set_result(None)


class Polls(Iterator[Values], Generic[Values]):
    """
    An endless iterator over the values of a device, made by `watch` of a blocking client.

    It ends when the client is closed, which any thread and signal handlers may do. It holds no
    resources between two values, so that a loop over it may be left at any time.
    """

    def __init__(
        self,
        interval: float,
        poll: Callable[[float], Values],
        now: Callable[[], float],
        wait: Callable[[float], bool],
        is_closed: Callable[[], bool],
    ) -> None:
        self._schedule = Schedule(interval)
        self._poll = poll
        self._now = now
        self._wait = wait
        self._is_closed = is_closed

    def __iter__(self) -> Iterator[Values]:
        return self

    def __next__(self) -> Values:
        due = self._schedule.due(self._now())
        if not self._wait(due):
            raise StopIteration
        self._schedule.polled(due)
        values = self._poll(due)
        if self._is_closed():
            raise StopIteration
        return values


class AwaitedPolls(AsyncIterator[Values], Generic[Values]):
    """
    An endless asynchronous iterator over the values of a device, made by `watch` of `AsyncClient`.

    It ends when the client is closed. It holds no resources between two values, so that a loop over
    it may be left at any time; waiting for the next values may be cancelled and started again.
    """

    def __init__(
        self,
        interval: float,
        poll: Callable[[float], Awaitable[Values]],
        now: Callable[[], float],
        wait: Callable[[float], Awaitable[bool]],
        is_closed: Callable[[], bool],
    ) -> None:
        self._schedule = Schedule(interval)
        self._poll = poll
        self._now = now
        self._wait = wait
        self._is_closed = is_closed

    def __aiter__(self) -> AsyncIterator[Values]:
        return self

    async def __anext__(self) -> Values:
        due = self._schedule.due(self._now())
        if not await self._wait(due):
            raise StopAsyncIteration
        self._schedule.polled(due)
        values = await self._poll(due)
        if self._is_closed():
            raise StopAsyncIteration
        return values


def interval_of(what: WatchedPoints | Plan, every: float) -> float:
    """Return the seconds from one poll to the next."""
    return getattr(what, "interval", every)


def watched(what: Any, names: Any, every: float, options: Any) -> WatchedPoints | Plan:
    """
    Return what is polled.

    Raises:
        TypeError, ValueError: as for `RegisterMap.plan` and `Plan`; or `names` without a map.
    """
    from ..maps.plan import planned
    from ..maps.register_map import RegisterMap, map_of

    if isinstance(what, RegisterMap | str | PathLike):
        from ..maps.watched import WatchedPoints

        return WatchedPoints(map_of(what), names, every, **options)
    if names is not None:
        raise ValueError("names are for a RegisterMap only")
    return planned(what, options)
