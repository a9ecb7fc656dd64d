"""
What a test left: tasks, timers, event loops, threads, child processes, descriptors, by name.

One fixture for all tests compares what there is before a test with what there is after it, when
all that the test itself set up was torn down. What fixtures of a wider scope hold belongs to
both. The comparison takes microseconds; names are looked for only where something differs.

The garbage of each test is collected at its end, so that a warning from garbage (a socket that
nobody closed, a coroutine that nobody awaited) fails the test that made it, not a later one.
"""

from __future__ import annotations

import _thread
import asyncio
import contextlib
import gc
import logging
import os
import socket
import threading
import time
import weakref
from asyncio import base_events, runners
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from _pytest.logging import caplog_records_key

from libmodbus_py.binding.library import replier

# Threads and processes that are about to end may take so long, in seconds. Only what is left
# behind for good waits for all of it.
MOMENT = 10.0
GLANCE = 0.005

DESCRIPTORS = "/proc/self/fd"
TASKS = Path("/proc/self/task")

# What the rest of the run keeps, whichever test had it made.
LASTING_DESCRIPTORS: set[str] = set()
LASTING_CHILDREN: set[str] = set()


def note_lasting(descriptor: int, process: int) -> None:
    """Let the rest of the run keep a descriptor and a child process: no test left them."""
    LASTING_DESCRIPTORS.add(str(descriptor))
    LASTING_CHILDREN.add(str(process))


class Snapshot(NamedTuple):
    """
    What there is at one time. `descriptors`: numbers, as text; `threads`: those that Python knows
    by name; `started`: how many threads run Python in all; `children`: process ids.
    """

    descriptors: frozenset[str]
    threads: frozenset[threading.Thread]
    started: int
    children: frozenset[str]

    @classmethod
    def taken(cls) -> Snapshot:
        """Return all descriptors, threads and processes."""
        threads = frozenset(threading.enumerate())
        descriptors = _descriptors() - LASTING_DESCRIPTORS
        return cls(descriptors, threads, _thread._count(), _children() - LASTING_CHILDREN)

    def has_less_than(self, after: Snapshot) -> bool:
        """Return whether something was added."""
        return bool(
            after.descriptors - self.descriptors
            or after.threads - self.threads
            or after.started > self.started
            or after.children - self.children
        )


def _descriptors() -> frozenset[str]:
    # The lowest free number is the one that the listing itself takes.
    own = os.dup(0)
    os.close(own)
    return frozenset(os.listdir(DESCRIPTORS)) - {str(own)}


def _children() -> frozenset[str]:
    if hasattr(os, "waitid"):  # PyPy lacks waitid, and always looks
        try:
            os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        except ChildProcessError:
            return frozenset()
    numbers: set[str] = set()
    for task in TASKS.iterdir():
        with contextlib.suppress(OSError):  # a thread that has ended meanwhile
            numbers.update((task / "children").read_text().split())
    return frozenset(numbers)


def _names(before: Snapshot, after: Snapshot) -> list[str]:
    names = [_named_descriptor(entry) for entry in sorted(after.descriptors - before.descriptors)]
    names += [f"thread {thread.name!r}" for thread in after.threads - before.threads]
    if after.started > before.started and not after.threads - before.threads:
        names.append("a thread without a name")
    names += [_named_process(entry) for entry in after.children - before.children]
    return [name for name in names if name]


def _named_descriptor(number: str) -> str:
    try:
        target = os.readlink(f"{DESCRIPTORS}/{number}")
    except OSError:
        return ""
    owner = _owner(int(number))
    return f"descriptor {number}: {target}{f', {owner}' if owner else ''}"


def _owner(number: int) -> str:
    """Return the addresses of a socket, or the object of the package with this descriptor."""
    try:
        copy = os.dup(number)
    except OSError:  # closed meanwhile
        return ""
    try:
        socket_ = socket.socket(fileno=copy)
    except OSError:
        os.close(copy)
        return next((f"of {item!r}" for item in gc.get_objects() if _holds(item, number)), "")
    with socket_:
        return f"{socket_.type.name} {socket_.getsockname()} {_peer(socket_)}".rstrip()


def _peer(socket_: socket.socket) -> str:
    with contextlib.suppress(OSError):
        return f"connected to {socket_.getpeername()}"
    return ""


def _holds(each: object, number: int) -> bool:
    if not type(each).__module__.startswith("libmodbus_py"):
        return False
    with contextlib.suppress(Exception):
        return bool(getattr(each, "descriptor", -1) == number)
    return False


def _named_process(number: str) -> str:
    with contextlib.suppress(OSError):
        line = Path("/proc", number, "cmdline").read_bytes().replace(b"\0", b" ").strip()
        state = Path("/proc", number, "stat").read_text().rpartition(")")[2].split()[0]
        note = " that has ended and was not waited for" if state == "Z" else ""
        return f"process {number}{note}: {line.decode(errors='replace')[:200]}"
    return ""


class Loops:
    """
    The event loops of a test, and what they held when they were closed. `left`: tasks and timers of
    loops that were closed since the last look, by name.
    """

    def __init__(self) -> None:
        self.left: list[str] = []
        self._open: weakref.WeakSet[asyncio.AbstractEventLoop] = weakref.WeakSet()
        self._known: frozenset[int] = frozenset()
        self._mains: weakref.WeakSet[Any] = weakref.WeakSet()

    def begin(self) -> None:
        """Forget what was left so far: fixtures of a wider scope may have left it."""
        self.left.clear()
        self._known = frozenset(map(id, self._open))

    def made(self, loop: asyncio.AbstractEventLoop) -> None:
        self._open.add(loop)

    def running(self, runner: asyncio.Runner, coroutine: object, *_: object) -> None:
        self._mains.add(coroutine)

    def cancelling(self, loop: asyncio.AbstractEventLoop) -> None:
        """
        Note tasks that a runner is about to cancel: the program that it ran forgot them, unless
        it was itself interrupted.
        """
        tasks = asyncio.all_tasks(loop)
        if not any(task.get_coro() in self._mains for task in tasks):
            # What was cancelled is about to end, whoever cancelled it.
            self.left += [_named_task(task) for task in tasks if not task.cancelling()]

    def closing(self, loop: Any) -> None:
        """Note timers that would have rung later; a loop that is closed already has none."""
        self._open.discard(loop)
        self.left += [f"timer {entry!r}" for entry in loop._scheduled if not entry.cancelled()]

    def names(self) -> list[str]:
        """Return the names of the leaks."""
        tasks = list(self.left)
        for loop in list(self._open):
            if id(loop) not in self._known and not loop.is_closed():
                tasks.append(f"event loop {loop!r}")
                tasks += [_named_task(all_task) for all_task in asyncio.all_tasks(loop)]
        return tasks


def _named_task(task: asyncio.Task[Any]) -> str:
    coroutine = task.get_coro()
    return f"task {task.get_name()!r}: {getattr(coroutine, '__qualname__', coroutine)}"


LOOPS = Loops()


def pytest_configure(config: pytest.Config) -> None:
    """Make event loops and their runners report what they hold when they end."""
    if not hasattr(base_events.BaseEventLoop.close, "__wrapped__"):
        _call_before(base_events.BaseEventLoop, "__init__", LOOPS.made)
        _call_before(base_events.BaseEventLoop, "close", LOOPS.closing)
        _call_before(runners, "_cancel_all_tasks", LOOPS.cancelling)
        _call_before(runners.Runner, "run", LOOPS.running)


def _call_before(owner: Any, name: str, tell: Callable[..., None]) -> None:
    wrapped = getattr(owner, name)

    def telling(*arguments: Any, **options: Any) -> Any:
        tell(*arguments)
        return wrapped(*arguments, **options)

    telling.__wrapped__ = wrapped  # type: ignore[attr-defined]
    setattr(owner, name, telling)


def freeze() -> None:
    """Leave what lives now out of every later collection, which it makes slow; PyPy cannot."""
    if hasattr(gc, "freeze"):
        gc.freeze()


@pytest.fixture(autouse=True)
def no_leaks(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail a test that left something behind, by name."""
    replier()  # each thread keeps one, and has it from its first request on
    LOOPS.begin()
    before = Snapshot.taken()
    yield
    if before.has_less_than(Snapshot.taken()):
        _forget_logs(request.node)
    names = remaining_leaks(before, LOOPS.names())
    freeze()
    if names:
        pytest.fail("left behind: " + "; ".join(names), pytrace=False)


def _forget_logs(item: pytest.Item) -> None:
    """Drop the tracebacks that pytest keeps for its report; their texts are enough for it."""
    for records in item.stash.get(caplog_records_key, {}).values():
        for record in records:
            if record.exc_info:
                logging.Formatter().format(record)
                record.exc_info = None


def remaining_leaks(before: Snapshot, names: list[str]) -> list[str]:
    """
    Collect garbage, and return the names of what is still there after a moment. `before`: what
    there was; `names`: of what event loops left.
    """
    # Frozen is what lived when the last test ended; so this looks at what this one made.
    gc.collect()
    until = time.monotonic() + MOMENT
    while before.has_less_than(after := Snapshot.taken()):
        leaks = _names(before, after)
        if time.monotonic() > until:
            return names + leaks
        time.sleep(GLANCE)
        gc.collect()
    return names
