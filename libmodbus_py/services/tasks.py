"""
Ends tasks, also those that lose a cancellation, and makes last calls in cancelled tasks.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Coroutine
from typing import Any

__all__ = ["AGAIN", "end_tasks", "finish"]

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


async def finish(call: Coroutine[Any, Any, Any], seconds: float) -> None:
    """
    Run the last call of an object that is being closed, for at most so many seconds. An exception
    that it raises is ignored.

    In a task that was cancelled, `asyncio.timeout` of Python 3.11.2 raises CancelledError at its
    end, so that objects after it would not be closed.
    """
    task = asyncio.ensure_future(call)
    try:
        await asyncio.wait([task], timeout=seconds)
    finally:
        if not task.cancel() and not task.cancelled():
            task.exception()  # else asyncio logs it
