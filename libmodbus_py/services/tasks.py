"""
The end of tasks, which may lose a cancellation or have been cancelled already.
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
    Cancel tasks, and wait until all have ended; what they raise is theirs.

    One cancellation is not enough: `asyncio.wait_for` of Python 3.11, which the clients of MQTT
    and NATS use, loses one that comes together with what it waits for.
    """
    while waiting := [task for task in tasks if not task.done()]:
        for task in waiting:
            task.cancel()
        await asyncio.wait(waiting, timeout=AGAIN)
    await asyncio.gather(*tasks, return_exceptions=True)  # else asyncio logs what they raised


async def finish(call: Coroutine[Any, Any, Any], seconds: float) -> None:
    """
    Run the last call of something that is closed, for so many seconds; what it raises is dropped.

    Within a task that was cancelled, `asyncio.timeout` of Python 3.11.2 raises CancelledError at
    its end, so that what follows it would not be closed.
    """
    task = asyncio.ensure_future(call)
    try:
        await asyncio.wait([task], timeout=seconds)
    finally:
        if not task.cancel() and not task.cancelled():
            task.exception()  # else asyncio logs it
