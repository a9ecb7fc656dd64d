"""
Ends tasks, also those that lose a cancellation, makes last calls in cancelled tasks, and tells how
long to wait before what has failed is tried again.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Coroutine
from typing import Any

__all__ = ["AGAIN", "Pauses", "end_tasks", "finish", "finishing"]

# Seconds before the first try after a failure, and before the later ones: a server that is down
# for an hour is asked 120 times.
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 30.0

# Seconds that an output has for its last readings, and to close, when the program ends.
FINISHING_S = 2.0

AGAIN = 5.0
"""Seconds after which a task that was cancelled, and has not ended, is cancelled again."""


async def end_tasks(tasks: Collection[asyncio.Task[Any]]) -> None:
    """
    Cancel tasks, and wait until all have ended. Exceptions that they raise are ignored.

    One cancellation is not enough: `asyncio.wait_for` of Python 3.11, which the clients of MQTT
    and NATS use, loses a cancellation that arrives together with the result that it waits for.
    """
    while waiting := [task for task in tasks if not task.done()]:
        for task in waiting:
            task.cancel()
        await asyncio.wait(waiting, timeout=AGAIN)
    await asyncio.gather(*tasks, return_exceptions=True)  # else asyncio logs what they raised


async def finish(call: Coroutine[Any, Any, Any], seconds: float | None = None) -> None:
    """
    Run the last call of an object that is being closed. An exception that it raises is ignored.

    In a task that was cancelled, `asyncio.timeout` of Python 3.11.2 raises CancelledError at its
    end, so that objects after it would not be closed.

    Args:
        seconds: for which the call may run; those of `finishing` unless given.
    """
    task = asyncio.ensure_future(call)
    try:
        await asyncio.wait([task], timeout=finishing() if seconds is None else seconds)
    finally:
        if not task.cancel() and not task.cancelled():
            task.exception()  # else asyncio logs it


def finishing() -> float:
    """Return the seconds for what is to be finished when the program ends."""
    return FINISHING_S


class Pauses:
    """
    The seconds between tries of what fails: each pause is twice as long as the one before.

    Args:
        longest: the longest pause, in seconds; 30 unless given.
    """

    def __init__(self, longest: float | None = None) -> None:
        self._longest = LONGEST_PAUSE_S if longest is None else longest
        self._next = FIRST_PAUSE_S

    def next(self) -> float:
        """Return the seconds until the next try."""
        pause, self._next = self._next, min(2 * self._next, self._longest)
        return pause

    def reset(self) -> None:
        """Begin with the first pause again: a try has succeeded."""
        self._next = FIRST_PAUSE_S
