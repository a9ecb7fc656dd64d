"""
Commands to write points, answered by the worker that polls the device; if none does, by another.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ..fleet.commands import Commands, wanted_of
from ..fleet.outputs.subjects import WRITE, asked_about, written
from ..fleet.readings import time_text

if TYPE_CHECKING:
    from nats.aio.client import Client
    from nats.aio.msg import Msg

__all__ = ["CommandService"]

# Commands beyond this are dropped, so that a flood cannot fill the memory.
MOST_WAITING = 256


class CommandService:
    """
    Answers what comes to ``modbus.write.DEVICE.POINT``.

    Args:
        client: a connection to NATS.
        commands: executes the commands.
        refusal: returns why a command to a device is refused; None if this worker polls the
            device, and "" if another worker answers.
    """

    def __init__(
        self, client: Client, commands: Commands, refusal: Callable[[str], str | None]
    ) -> None:
        self._client = client
        self._commands = commands
        self._refusal = refusal
        self._tasks: set[asyncio.Task[None]] = set()

    async def begin(self) -> None:
        """Subscribe to commands. The client subscribes again after each reconnection."""
        await self._client.subscribe(f"{WRITE}.*.*", cb=self._note)

    async def end(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _note(self, message: Msg) -> None:
        if len(self._tasks) < MOST_WAITING:
            task = asyncio.create_task(self._answer(message))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _answer(self, message: Msg) -> None:
        device, point = asked_about(message.subject)
        refusal = self._refusal(device)
        if refusal == "":
            return
        wanted = wanted_of(message.data)
        outcome = (
            await self._commands.answer(device, point, wanted)
            if refusal is None
            else _refused(refusal, wanted.id)
        )
        data = json.dumps(outcome, ensure_ascii=False).encode()
        with contextlib.suppress(Exception):
            if message.reply:
                await self._client.publish(message.reply, data)
            await self._client.publish(written(device, point), data)


def _refused(why: str, id: object) -> dict[str, Any]:
    outcome: dict[str, Any] = {"ok": False, "time": time_text(time.time()), "error": why}
    return outcome if id is None else {**outcome, "id": id}
