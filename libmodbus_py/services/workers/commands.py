"""
Commands to write points. The worker that polls the device answers them; if no worker polls it,
another worker answers.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
from typing import TYPE_CHECKING

from ..fleet.commands import Commands, encoded, wanted_of
from ..tasks import end_tasks
from .stream import WRITE, asked_about, written

if TYPE_CHECKING:
    from nats.aio.client import Client
    from nats.aio.msg import Msg
    from nats.aio.subscription import Subscription

__all__ = ["CommandService"]

# Outcomes are sent only to inboxes: _INBOX.ID, inboxes with a prefix that a client has chosen, and
# those that servers make between accounts and clusters. A worker may publish to $JS.API and $KV; a
# client that may only send commands must not be able to make a worker publish there.
_INBOX = re.compile(
    r"(_GR_\.\w{1,64}\.\w{1,64}\.)?_(INBOX[\w-]{0,64}|R_)(\.[\w-]{1,64}){1,6}", re.ASCII
)

# The most commands that wait for an outcome. Others are dropped, so that a flood of commands cannot
# fill the memory.
MOST_WAITING = 256


class CommandService:
    """
    Answers the commands that are published to ``modbus.write.DEVICE.POINT``.

    Args:
        client: a connection to NATS.
        commands: carries out the commands, and refuses those that no worker can carry out.
    """

    def __init__(self, client: Client, commands: Commands) -> None:
        self._client = client
        self._commands = commands
        self._tasks: set[asyncio.Task[None]] = set()
        self._subscription: Subscription | None = None
        self._is_open = False

    async def begin(self) -> None:
        """Subscribe to commands. The client subscribes again after each reconnection."""
        self._is_open = True
        self._subscription = await self._client.subscribe(f"{WRITE}.*.*", cb=self._note)

    def stop(self) -> None:
        """Carry out no more commands, not even those that were already received."""
        self._is_open = False
        for task in self._tasks:
            task.cancel()

    async def end(self) -> None:
        """Stop, and unsubscribe."""
        self.stop()
        subscription, self._subscription = self._subscription, None
        await end_tasks(list(self._tasks))
        if subscription is not None:
            with contextlib.suppress(Exception):
                await subscription.unsubscribe()

    async def _note(self, message: Msg) -> None:
        if self._is_open and len(self._tasks) < MOST_WAITING:
            task = asyncio.create_task(self._answer(message))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _answer(self, message: Msg) -> None:
        names = asked_about(message.subject)
        # Commands with other subjects are dropped: their sender would choose the subject to which
        # the outcome is published.
        outcome = names and await self._commands.answer(*names, wanted_of(message.data))
        if not (names and outcome):
            return
        data = encoded(outcome)
        with contextlib.suppress(Exception):
            if _INBOX.fullmatch(message.reply):
                await self._client.publish(message.reply, data)
            await self._client.publish(written(*names), data)
