"""
Steps that wait: a generator yields the event to wait for, and its caller decides how.

`run` polls, for blocking clients; `run_async` waits in the event loop. So connecting, and
everything else that alternates with the peer, is written once.
"""

from __future__ import annotations

import errno
import math
import os
import select
import threading
import time
from collections.abc import Callable, Generator
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from ..system import Flag
from .hosts import Resolve, ask, numeric

if TYPE_CHECKING:
    import asyncio  # which blocking clients do not need: functions import it

READ, WRITE = select.POLLIN, select.POLLOUT

# Seconds that the system waits at a time. A signal that comes just before it begins to wait does
# not end the wait, and Python's handler runs behind it: Ctrl-C must not last as long as a timeout.
LONGEST = 1.0

Result = TypeVar("Result")


class Ready(NamedTuple):
    """Wait until a descriptor is ready; False if the deadline (time.monotonic) comes first."""

    descriptor: int
    events: int
    deadline: float


Steps = Generator[Ready | Resolve, Any, Result]


class WaitInterrupted(Exception):
    """The wait was ended from another thread."""


class Waker:
    """
    Waits for descriptors and for times; another thread, or a signal handler, may end each wait.
    """

    descriptor: int = -1
    _flag: Flag | None = None
    now: Callable[[], float] = staticmethod(time.monotonic)
    sleep: Callable[[float], None] = staticmethod(time.sleep)

    def __init__(self) -> None:
        self.renew()

    def renew(self) -> None:
        """Reset the waker, as in a forked child, where another thread may have held the lock."""
        # Reentrant, because a signal handler may call `wake` while its own thread does.
        self._lock = threading.RLock()
        self.close()
        self._flag = Flag()
        self.descriptor = self._flag.descriptor

    def wake(self) -> None:
        with self._lock:
            if self._flag is not None:
                self._flag.set()

    def clear(self) -> None:
        with self._lock:
            if self._flag is not None:
                self._flag.clear()

    def close(self) -> None:
        with self._lock:
            flag, self._flag, self.descriptor = self._flag, None, -1
            if flag is not None:
                flag.close()

    def __del__(self) -> None:
        self.close()

    def watch(self, descriptor: int) -> None:
        """Set the descriptor and events that `is_ready` waits for."""
        self._watched = descriptor
        self._poll = select.poll()
        self._poll.register(self.descriptor, READ)
        self._poll.register(descriptor, READ)

    def is_ready(self, seconds: float) -> bool:
        """Wait until there is something to read; return False if the time is over first."""
        if not 0 < seconds <= LONGEST:
            return self._watched in self._polled(self._poll, seconds)
        # As `_polled`, without three calls for each request; poll rounds up.
        ready = self._poll.poll(seconds * 1000)
        if not ready:
            return False
        if ready[0][0] == self.descriptor:
            raise WaitInterrupted
        return True

    def wait(self, descriptor: int, events: int, deadline: float) -> bool:
        """As `is_ready`, for any descriptor (-1 for none), until a time (time.monotonic)."""
        poll = select.poll()
        poll.register(self.descriptor, READ)
        if descriptor >= 0:
            poll.register(descriptor, events)
        return descriptor in self._polled(poll, deadline - self.now())

    def _polled(self, poll: select.poll, seconds: float) -> dict[int, int]:
        ready = dict(poll.poll(milliseconds(min(seconds, LONGEST))))
        if seconds > LONGEST and not ready:
            deadline = self.now() + seconds - LONGEST
            while not ready and (remainder := deadline - self.now()) > 0:
                ready = dict(poll.poll(milliseconds(min(remainder, LONGEST))))
        if self.descriptor in ready:
            raise WaitInterrupted
        return ready


def milliseconds(seconds: float) -> int:
    """Return milliseconds, rounded up, because poll would spin on 0; at most a day."""
    return -int(-min(max(0.0, seconds), 86_400.0) * 1000 // 1)


def run(steps: Steps[Result], waker: Waker) -> Result:
    """Run steps to their end; the waker may end this by Woken."""
    try:
        step = next(steps)
        while True:
            try:
                if isinstance(step, Resolve):
                    answer: Any = _look_up(step, waker)
                else:
                    answer = waker.wait(*step)
            except OSError as error:
                of_system(error)
                step = steps.throw(error)
            else:
                step = steps.send(answer)
    except StopIteration as done:
        result: Result = done.value
        return result
    finally:
        steps.close()


def _look_up(lookup: Resolve, waker: Waker) -> list[Any]:
    if answer := numeric(lookup):
        return answer
    signal = Waker()
    try:
        question = ask(lookup, signal.wake)
        if not waker.wait(signal.descriptor, READ, lookup.deadline):
            raise timed_out()
        return question.result()
    finally:
        signal.close()  # an error that the caller keeps would keep it open


def timed_out() -> TimeoutError:
    """Return the error of the system for a wait that took too long."""
    return TimeoutError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))


def of_system(error: OSError) -> OSError:
    """Return an error of the system; raise any other, as a signal handler may raise one."""
    if error.errno is None and error.strerror is None:
        raise error
    return error


# --- in an event loop -----------------------------------------------------------------------


async def run_async(steps: Steps[Result]) -> Result:
    """Run steps to their end in the event loop; cancelling closes them."""
    try:
        step = next(steps)
        while True:
            try:
                answer: Any
                if isinstance(step, Resolve):
                    answer = await look_up(step)
                else:
                    answer = await _ready(step)
            except OSError as error:
                of_system(error)
                step = steps.throw(error)
            else:
                step = steps.send(answer)
    except StopIteration as done:
        result: Result = done.value
        return result
    finally:
        steps.close()


async def look_up(lookup: Resolve) -> list[Any]:
    """Return what getaddrinfo finds, or raise its OSError, or TimeoutError."""
    if answer := numeric(lookup):
        return answer
    import asyncio

    loop = asyncio.get_running_loop()
    ready = loop.create_future()
    timeout = asyncio.timeout_at(None if lookup.deadline == math.inf else lookup.deadline)
    question = ask(lookup, lambda: loop.call_soon_threadsafe(resolve, ready))
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


async def _ready(condition: Ready) -> bool:
    import asyncio

    loop = asyncio.get_running_loop()
    ready = loop.create_future()
    add, remove = loop.add_writer, loop.remove_writer
    if condition.events == READ:
        add, remove = loop.add_reader, loop.remove_reader
    add(condition.descriptor, resolve, ready)
    timeout = asyncio.timeout_at(condition.deadline)
    try:
        async with timeout:
            await ready
    except TimeoutError:
        if not timeout.expired():
            raise
        return False
    finally:
        remove(condition.descriptor)
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
