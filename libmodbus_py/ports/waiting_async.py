"""
Steps that wait, run by the event loop, and a timer; separate, because blocking clients need no
asyncio.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import Any, TypeVar

from .hosts import Resolve, ask, numeric
from .waiting import READ, Ready, Steps, of_system, timed_out

Result = TypeVar("Result")


async def run_async(steps: Steps[Result]) -> Result:
    """Run steps to their end in the event loop; cancelling closes them."""
    try:
        wanted = next(steps)
        while True:
            try:
                found: Any
                if isinstance(wanted, Resolve):
                    found = await look_up(wanted)
                else:
                    found = await _ready(wanted)
            except OSError as error:
                of_system(error)
                wanted = steps.throw(error)
            else:
                wanted = steps.send(found)
    except StopIteration as done:
        result: Result = done.value
        return result
    finally:
        steps.close()


async def look_up(wanted: Resolve) -> list[Any]:
    """Return what getaddrinfo finds, or raise its OSError, or TimeoutError."""
    if found := numeric(wanted):
        return found
    loop = asyncio.get_running_loop()
    ready = loop.create_future()
    timeout = asyncio.timeout_at(None if wanted.deadline == math.inf else wanted.deadline)
    question = ask(wanted, lambda: loop.call_soon_threadsafe(resolve, ready))
    try:
        async with timeout:
            await ready
    except TimeoutError as error:
        if not timeout.expired():
            raise
        raise timed_out() from error
    return question.result()


def resolve(future: asyncio.Future[None]) -> None:
    """Complete a future, unless it was cancelled."""
    if not future.done():
        future.set_result(None)


async def _ready(wanted: Ready) -> bool:
    loop = asyncio.get_running_loop()
    ready = loop.create_future()
    add, remove = (
        (loop.add_reader, loop.remove_reader)
        if wanted.events == READ
        else (loop.add_writer, loop.remove_writer)
    )
    add(wanted.descriptor, resolve, ready)
    timeout = asyncio.timeout_at(wanted.deadline)
    try:
        async with timeout:
            await ready
    except TimeoutError:
        if not timeout.expired():
            raise
        return False
    finally:
        remove(wanted.descriptor)
    return True


class Alarm:
    """
    A timer that is replaced only when an earlier time is set, because most timers are not needed.

    asyncio ends timers early, by up to the resolution of its clock. So `ring` gets the time: that
    of the clock, or the one that the alarm was set for, whichever is later. Who asks the clock
    again would find that nothing is due, and set the alarm for the same time.
    """

    def __init__(self, ring: Callable[[float], object]) -> None:
        self.at: float = math.inf
        self._ring = ring
        self._timer: asyncio.TimerHandle | None = None

    def set(self, at: float, loop: asyncio.AbstractEventLoop) -> None:
        """Ring at this time, or earlier if the alarm is set for an earlier time."""
        if at < self.at:
            self.cancel()
            self.at = at
            self._timer = loop.call_at(at, self._rings, loop)

    def cancel(self) -> None:
        """Clear the alarm; it can be set again."""
        if self._timer is not None:
            self._timer.cancel()
        self._timer, self.at = None, math.inf

    def _rings(self, loop: asyncio.AbstractEventLoop) -> None:
        now = max(loop.time(), self.at)
        self._timer, self.at = None, math.inf
        self._ring(now)
