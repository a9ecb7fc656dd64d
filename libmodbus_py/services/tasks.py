"""
The end of tasks that may lose a cancellation.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from typing import Any

__all__ = ["AGAIN", "end_tasks"]

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
