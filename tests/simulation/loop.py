"""An event loop on simulated time: when all wait, the clock moves to whatever is next."""

import asyncio
import contextlib
import math
import selectors
from collections.abc import Callable, Coroutine, Iterator, Mapping
from typing import Any, TypeVar

from .events import Events

Result = TypeVar("Result")

# Turns of the loop at one time, after which somebody must be asking the clock without end; the
# most that any test takes are about a hundred.
MOST_TURNS = 10_000

# Simulated seconds in which a task that was cancelled must end.
LAST_WAIT = 3600.0

# Descriptors of the simulation begin here; those below are the system's.
FIRST_DESCRIPTOR = 10**6


class Stuck(AssertionError):
    """Everybody waits, and nothing will ever happen; or nobody waits, and time stands still."""


class Descriptors:
    """Which simulated descriptors can be read or written."""

    def __init__(self) -> None:
        self.readable: set[int] = set()
        self.writable: set[int] = set()
        self._next = FIRST_DESCRIPTOR

    def new(self) -> int:
        """Return a new descriptor."""
        self._next += 1
        return self._next

    def forget(self, descriptor: int) -> None:
        """Forget a descriptor."""
        self.readable.discard(descriptor)
        self.writable.discard(descriptor)


class Selector(selectors._BaseSelectorImpl):
    """Waits in simulated time for simulated descriptors, and never for the system's."""

    def __init__(self, events: Events, descriptors: Descriptors) -> None:
        super().__init__()
        self._events = events
        self._descriptors = descriptors
        self._keys: dict[int, selectors.SelectorKey] = {}
        self._readers: set[int] = set()
        self._writers: set[int] = set()
        self._system = selectors.DefaultSelector()
        self.interrupt: Callable[[], bool] = lambda: False
        self.turns: int = 0
        self.early: float = 0.0
        self._turns_before: int = 0
        self._moved_at: float = -math.inf
        self.is_woken: bool = False
        self.on_turn: Callable[[], object] = lambda: None

    def _fileobj_lookup(self, fileobj: Any) -> int:
        return fileobj if isinstance(fileobj, int) else int(fileobj.fileno())

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        key = super().register(fileobj, events, data)
        self._keys[key.fd] = key
        if key.fd < FIRST_DESCRIPTOR:
            self._system.register(key.fd, events, data)
        else:
            self._note(key.fd, events)
        return key

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        key = super().unregister(fileobj)
        del self._keys[key.fd]
        if key.fd < FIRST_DESCRIPTOR:
            self._system.unregister(key.fd)
        else:
            self._note(key.fd, 0)
        return key

    def modify(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        self.unregister(fileobj)
        return self.register(fileobj, events, data)

    def _note(self, descriptor: int, events: int) -> None:
        for kind, group in (
            (selectors.EVENT_READ, self._readers),
            (selectors.EVENT_WRITE, self._writers),
        ):
            (group.add if events & kind else group.discard)(descriptor)

    def close(self) -> None:
        self._system.close()
        super().close()

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        events = self._events
        until = math.inf if timeout is None else events.now + max(0.0, timeout - self.early)
        self.turns += 1
        if events.now != self._moved_at:
            self._turns_before, self._moved_at = self.turns, events.now
        elif self.turns - self._turns_before > MOST_TURNS:
            self._turns_before = self.turns  # cancelled tasks may end now
            raise Stuck(f"the loop turns without end at {events.now!r} s")
        self.on_turn()
        if events.next_at <= events.now:
            events.advance(events.now)
        while not (ready := self._ready()):
            if events.now >= until or self.interrupt():
                return []
            if ready := self._awoken():
                return ready
            if min(events.next_at, until) == math.inf:
                raise Stuck("everybody waits, and nothing will ever happen")
            events.advance(until)
        return ready

    def _awoken(self) -> list[tuple[selectors.SelectorKey, int]]:
        """Return the system's descriptors that are ready: one by which other threads wake us."""
        if self.is_woken or len(self._system.get_map()) > 1:
            self.is_woken = False
            return self._system.select(0)
        return []

    def _ready(self) -> list[tuple[selectors.SelectorKey, int]]:
        readable, writable = self._descriptors.readable, self._descriptors.writable
        if self._readers.isdisjoint(readable) and self._writers.isdisjoint(writable):
            return []
        read = self._readers & readable
        write = self._writers & writable
        ready = [
            (
                self._keys[descriptor],
                (descriptor in read) * selectors.EVENT_READ
                | (descriptor in write) * selectors.EVENT_WRITE,
            )
            for descriptor in sorted(read | write)
        ]
        self._events.random.shuffle(ready)
        return ready


class VirtualLoop(asyncio.SelectorEventLoop):
    """
    An event loop whose time is that of the events. `early`: the seconds by which timers end before
    their time. asyncio allows a loop the resolution of its clock, which is one step of a float here
    unless a test says more.
    """

    early: float = 0.0

    def __init__(self, events: Events, descriptors: Descriptors) -> None:
        self._events = events
        self._waiting = Selector(events, descriptors)
        self._waiting.early = self.early
        super().__init__(self._waiting)

    @property
    def _clock_resolution(self) -> float:
        return max(math.ulp(self._events.now), 2 * self.early)

    @_clock_resolution.setter
    def _clock_resolution(self, seconds: float) -> None:
        """Ignore that of the system's clock, which the base class sets."""

    def time(self) -> float:
        return self._events.now

    def _write_to_self(self) -> None:
        super()._write_to_self()  # type: ignore[misc]
        self._waiting.is_woken = True

    def before_cancelling(self) -> None:
        """Called before what is left is cancelled."""

    @property
    def turns(self) -> int:
        """How many turns it has taken."""
        return self._waiting.turns

    def call_each_turn(self, call: Callable[[], object]) -> None:
        """Call a function whenever a turn ends."""
        self._waiting.on_turn = call

    def run_until(self, is_so: Callable[[], bool], seconds: float) -> bool:
        """Run until a condition holds, which is looked at whenever everybody waits."""
        until = self._events.now + seconds
        self._events.at(until, lambda: None)

        def interrupt() -> bool:
            if not is_so() and self._events.now < until:
                return False
            self.stop()
            return True

        self._waiting.interrupt = interrupt
        try:
            self.run_forever()
        finally:
            self._waiting.interrupt = lambda: False
        return is_so()


def run(main: Coroutine[Any, Any, Result], loop: VirtualLoop) -> Result:
    """Run a coroutine to its end, and close the loop."""
    with contextlib.closing(loop), complaints_of(loop) as complaints:
        asyncio.set_event_loop(loop)
        try:
            result = loop.run_until_complete(main)
            tasks = [repr(task.get_coro()) for task in asyncio.all_tasks(loop)]
        finally:
            cancel_all(loop)
            asyncio.set_event_loop(None)
    assert not complaints, complaints
    assert not tasks, tasks
    return result


@contextlib.contextmanager
def complaints_of(loop: asyncio.AbstractEventLoop) -> Iterator[list[Mapping[str, Any]]]:
    """Collect what the loop would have logged: exceptions that nobody took."""
    complaints: list[Mapping[str, Any]] = []

    def note(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        complaints.append(context)

    loop.set_exception_handler(note)
    yield complaints


def cancel_all(loop: VirtualLoop) -> set[asyncio.Task[Any]]:
    """
    Cancel the tasks that are left, wait until they end, and return them. Raise `AssertionError`:
    some do not end; they are named.
    """
    loop.before_cancelling()
    tasks = asyncio.all_tasks(loop)
    for task in tasks:
        task.cancel()
    if tasks:
        with contextlib.suppress(Stuck):  # some do not end, and are named below
            loop.run_until(asyncio.gather(*tasks, return_exceptions=True).done, LAST_WAIT)
    endless = [repr(task) for task in tasks if not task.done()]
    assert not endless, f"cancelled, and did not end: {endless}"
    loop.run_until_complete(loop.shutdown_asyncgens())
    return tasks
