"""
A test that lasts as long as its limit has failed, whatever it does, and its report says where it
stood.

    at the limit          `TimeLimit` is raised in the main thread, and again every 5 s while it is
                          swallowed; event loops let it through, because it is a KeyboardInterrupt
    the phase has ended   it has failed, also if nothing came of the exception
    teardown then         has 30 s; the exception is one after which pytest tears down the rest
    60 s after the limit  the process ends, with the stacks of all threads on stderr;
                          pytest-xdist reports the test, and goes on in another process
    the run has ended     a thread that does not end has another 60 s

The times are pytest-timeout's: 180 s, unless a mark says otherwise.
"""

import asyncio
import faulthandler
import re
import signal
import sys
import threading
import traceback
from collections.abc import Generator
from types import FrameType
from typing import Any

import pytest
from _pytest.faulthandler import fault_handler_stderr_fd_key

AGAIN_S, TEARDOWN_S, LAST_S = 5.0, 30.0, 60.0

# Frames of a stack, and tasks, that are shown.
FRAMES, TASKS = 12, 10

# Frames of what runs tests, which are not.
RUNNER = re.compile(r"/(_pytest|pluggy|pytest|xdist|execnet)/")


class TimeLimit(KeyboardInterrupt):
    """The test lasts as long as its limit."""


class Limit:
    """The limit of the test that runs. `text`: what the report says; "" before the limit."""

    def __init__(self, seconds: float, item: pytest.Item) -> None:
        self.text = ""
        self.is_teardown = False
        self._seconds = seconds
        signal.signal(signal.SIGALRM, self._ring)
        signal.setitimer(signal.ITIMER_REAL, seconds, AGAIN_S)
        # Python's own handler does not run while C code keeps the main thread.
        file = item.config.stash[fault_handler_stderr_fd_key]
        faulthandler.dump_traceback_later(seconds + LAST_S, exit=True, file=file)

    def end(self) -> None:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        faulthandler.cancel_dump_traceback_later()

    def end_phase(self) -> None:
        """Raise the failure of a phase in which the limit was reached."""
        if self.text:
            signal.setitimer(signal.ITIMER_REAL, TEARDOWN_S, AGAIN_S)
            text, self.text = self.text, ""
            raise pytest.fail.Exception(text, pytrace=False) from None

    def _ring(self, number: int, frame: FrameType | None) -> None:
        if not self.text:
            phase = "the teardown" if self.is_teardown else "the test"
            self.text = f"{phase} reached the limit of {self._seconds:g} s\n{where(frame)}"
        raise pytest.fail.Exception(self.text) if self.is_teardown else TimeLimit(self.text)


def where(frame: FrameType | None) -> str:
    """Return the stacks of the main thread, of tasks in its event loop, and of other threads."""
    stack = [frame_ for frame_ in traceback.format_stack(frame) if not RUNNER.search(frame_)]
    stacks = {"the main thread": stack}
    loop = asyncio._get_running_loop()
    tasks = sorted(asyncio.all_tasks(loop), key=str) if loop is not None else []
    for task in tasks[:TASKS]:
        frames = task.get_stack(limit=FRAMES)
        lines = [traceback.format_stack(frame, limit=1)[0] for frame in frames]
        stacks[f"task {task.get_name()!r}"] = lines
    names = {thread.ident: thread.name for thread in threading.enumerate()}
    for number, top in sys._current_frames().items():
        if number != threading.main_thread().ident:
            stacks[f"thread {names.get(number, number)!r}"] = traceback.format_stack(top)
    return "\n".join(f"{name}:\n{''.join(lines[-FRAMES:])}" for name, lines in stacks.items())


LIMIT = pytest.StashKey[Limit]()


def pytest_timeout_set_timer(item: pytest.Item, settings: Any) -> bool:
    """Take the place of pytest-timeout's own timers."""
    if threading.current_thread() is threading.main_thread():
        item.stash[LIMIT] = Limit(settings.timeout, item)
    return True


def pytest_timeout_cancel_timer(item: pytest.Item) -> bool:
    """Keep the timer: pytest-timeout cancels it when a test has failed, before the teardown."""
    return True


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, Any, Any]:
    try:
        return (yield)
    finally:
        if LIMIT in item.stash:
            item.stash[LIMIT].end()


def _phase(item: pytest.Item) -> Generator[None, Any, Any]:
    limit = item.stash.get(LIMIT, None)
    if limit is None:
        return (yield)
    try:
        outcome = yield
    except BaseException:
        limit.end_phase()
        raise
    limit.end_phase()
    return outcome


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None, Any, Any]:
    return (yield from _phase(item))


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, Any, Any]:
    return (yield from _phase(item))


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item) -> Generator[None, Any, Any]:
    if LIMIT in item.stash:
        item.stash[LIMIT].is_teardown = True
    return (yield from _phase(item))


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: pytest.Config) -> None:
    """End a process that waits for a thread; pytest-xdist ends those of its workers."""
    if not hasattr(config, "workerinput"):
        faulthandler.dump_traceback_later(LAST_S, exit=True, file=sys.__stderr__)
