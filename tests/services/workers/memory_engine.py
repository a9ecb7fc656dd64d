"""
A bucket and a client of an engine in memory, whose errors and pauses a test decides.
"""

from __future__ import annotations

import asyncio
import functools
import itertools
from collections.abc import Callable, Coroutine
from types import SimpleNamespace
from typing import Any, TypeVar

from libmodbus_py.services.engine.buckets import Change
from libmodbus_py.services.engine.connection import EngineError
from tests.simulation.network import Network

Result = TypeVar("Result")


def run(main: Coroutine[Any, Any, Result]) -> Result:
    """Run a coroutine in simulated time; no task may be left."""
    return Network().run(lambda: main)


def simulated(test: Callable[..., Coroutine[Any, Any, None]]) -> Callable[..., None]:
    """Make a test of a coroutine, which runs in simulated time."""

    @functools.wraps(test)
    def whole(*given: Any, **fixtures: Any) -> None:
        run(test(*given, **fixtures))

    return whole


def now() -> float:
    """The simulated time."""
    return asyncio.get_running_loop().time()


class MemoryClient:
    """A connection to the engine, over which nobody sends commands."""

    is_connected, is_closed = True, False

    async def subscribe(self, *_: Any, **__: Any) -> Any:
        return SimpleNamespace(unsubscribe=functools.partial(asyncio.sleep, 0))


class MemoryWatch:
    """See `libmodbus_py.services.engine.buckets.Watch`."""

    def __init__(
        self,
        bucket: MemoryBucket,
        on_change: Callable[[Change | None], None],
        on_gap: Callable[[], None],
    ) -> None:
        self.is_broken = False
        self.on_change = on_change
        self._on_gap = on_gap
        self._bucket = bucket

    def miss(self) -> None:
        """Note that changes were missed."""
        self.is_broken = True
        self._on_gap()

    async def end(self) -> None:
        self.is_broken = True
        self._bucket.watches.remove(self)


class MemoryBucket:
    """
    A key-value bucket; see `libmodbus_py.services.engine.buckets.Bucket`.

    Attributes:
        error: raised by each call, if there is one.
        is_mute: whether a watch is told nothing of what is there.
        holds: whether writes take until this is over.
        watched: how often somebody began to watch.
        watches: those that go on.
        puts: keys and values that somebody wanted written.
    """

    name = "modbus-fleet"

    def __init__(self) -> None:
        self.client = MemoryClient()
        self.values: dict[str, tuple[bytes | None, int]] = {}
        self.error: EngineError | None = None
        self.is_mute = False
        self.holds: asyncio.Event | None = None
        self.watched = 0
        self.watches: list[MemoryWatch] = []
        self.puts: list[tuple[str, bytes | None]] = []
        self._revisions = itertools.count(1)

    async def put(self, key: str, value: bytes | None, last: int) -> int:
        self.puts.append((key, value))
        if self.holds is not None:
            await self.holds.wait()
        await asyncio.sleep(0)
        if self.error is not None:
            raise self.error
        if self.values.get(key, (None, 0))[1] != last:
            return 0
        revision = self.write(key, value)
        return 1 if value is None else revision

    def write(self, key: str, value: bytes | None) -> int:
        """Write without a condition, and tell all who watch."""
        revision = next(self._revisions)
        self.values[key] = value, revision
        for watch in list(self.watches):
            watch.on_change(Change(key, value, revision))
        return revision

    async def watch(
        self, on_change: Callable[[Change | None], None], on_gap: Callable[[], None] = lambda: None
    ) -> MemoryWatch:
        await asyncio.sleep(0)
        if self.error is not None:
            raise self.error
        self.watched += 1
        watch = MemoryWatch(self, on_change, on_gap)
        self.watches.append(watch)
        if not self.is_mute:
            for key, (value, revision) in sorted(self.values.items(), key=lambda each: each[1][1]):
                on_change(Change(key, value, revision))
            on_change(None)
        return watch
