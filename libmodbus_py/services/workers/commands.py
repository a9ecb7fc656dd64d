"""
Commands to write points, which one of the workers answers.

The worker that polls the device carries it out, while its lease is valid. Commands to devices that
do not exist, or whose slots have no worker, are refused by the worker with the lowest id. Commands
to the devices of a worker that has just died are not answered: it may have carried them out.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
from collections.abc import AsyncIterator, Callable, Iterator
from typing import TYPE_CHECKING

from ..engine.connection import what
from ..fleet.commands import Commands, encoded, wanted_of
from ..tasks import end_tasks, finish
from .records import Connection
from .stream import WRITE, asked_about, written
from .worker import Worker

if TYPE_CHECKING:
    from nats.aio.client import Client
    from nats.aio.msg import Msg

__all__ = ["CommandService", "Locations"]

# Outcomes are sent only to inboxes: _INBOX.ID, inboxes with a prefix that a client has chosen, and
# those that servers make between accounts and clusters. A worker may publish to $JS.API and $KV; a
# client that may only send commands must not be able to make a worker publish there.
_INBOX = re.compile(
    r"(_GR_\.\w{1,64}\.\w{1,64}\.)?_(INBOX[\w-]{0,64}|R_)(\.[\w-]{1,64}){1,6}", re.ASCII
)

# The most commands that wait for an outcome. Others are dropped, so that a flood of commands cannot
# fill the memory.
MOST_WAITING = 256

# Seconds before subscribing is tried again, and for unsubscribing.
PAUSE_S = 0.25


class CommandService:
    """
    Answers the commands that are published to ``modbus.write.DEVICE.POINT``.

    Args:
        client: a connection to NATS.
        commands: carries out the commands, and refuses those that no worker can carry out.
        say: logs a line.
    """

    def __init__(self, client: Client, commands: Commands, say: Callable[[str], None]) -> None:
        self._client = client
        self._commands = commands
        self._say = say
        self._tasks: set[asyncio.Task[None]] = set()
        self._is_on = False
        self._switched = asyncio.Event()

    def switch(self, is_on: bool) -> None:
        """Take commands from now on, or none, not even those that were already received."""
        if is_on != self._is_on:
            self._is_on = is_on
            self._switched.set()
            for task in self._tasks:
                task.cancel()

    async def run(self) -> None:
        """Subscribe to commands while they are taken, until cancelled."""
        while True:
            self._switched.clear()
            try:
                async with self._subscribed():
                    await self._switched.wait()
            except Exception as error:
                self._say(f"commands: {what(error)}")
                await asyncio.sleep(PAUSE_S)

    @contextlib.asynccontextmanager
    async def _subscribed(self) -> AsyncIterator[None]:
        subscription = None
        try:
            if self._is_on:
                # The client subscribes again after each reconnection.
                subscription = await self._client.subscribe(f"{WRITE}.*.*", cb=self._receive)
            yield
        finally:
            await end_tasks(list(self._tasks))
            if subscription is not None:
                await finish(subscription.unsubscribe(), PAUSE_S)

    async def _receive(self, message: Msg) -> None:
        if self._is_on and len(self._tasks) < MOST_WAITING:
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


class Locations:
    """
    Finds the worker that answers commands to devices that this worker does not poll.

    Args:
        worker: its view of the bucket is searched.
    """

    def __init__(self, worker: Worker) -> None:
        self._worker = worker
        # The connection of each device, as of this revision.
        self._connections: dict[str, Connection] = {}
        self._as_of = -1

    def refusal(self, device: str, now: float) -> str:
        """
        Return the reason to refuse a command to a device that this worker does not poll; "" if
        another worker answers the command, or none does.
        """
        worker = self._worker
        if not worker.is_first(now):
            return ""
        connection = self._connection_of(device)
        if connection is None:
            return f"there is no device {device!r}"
        holder = worker.view.holder(connection.slot)
        if holder is None or holder.state == "ended" or worker.is_mine(connection.slot):
            return f"no worker polls {device!r} now"
        return ""

    def _connection_of(self, device: str) -> Connection | None:
        view = self._worker.view
        if self._as_of != view.last_touched:
            self._as_of = view.last_touched
            self._connections = {
                name: connection
                for connection in view.connections
                for name in _names(connection.devices)
            }
        return self._connections.get(device)


def _names(devices: str) -> Iterator[str]:
    """Yield the names of devices in JSON, which any program may have written to the bucket."""
    found = json.loads(devices)
    listed = found.get("devices") if isinstance(found, dict) else None
    for each in listed if isinstance(listed, list) else ():
        name = each.get("name") if isinstance(each, dict) else None
        if isinstance(name, str):
            yield name
