"""
Messages for clients of NATS: the stream of JetStream that keeps readings for later consumers, and
commands to write points, which one of the workers answers.

For an MQTT client of the NATS server the subjects are topics, with / in place of each dot.

::

    modbus.readings.DEVICE              the readings of a device
    modbus.write.DEVICE.POINT           a value to write; the reply contains the outcome
    modbus.written.DEVICE.POINT         the outcome, for clients that cannot receive replies

The worker that polls the device carries a command out, while its lease is valid. Commands to
devices that do not exist, or whose slots have no worker, are refused by the worker with the lowest
id. Commands to the devices of a worker that has just died are not answered: it may have carried
them out.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

from ..engine.buckets import TIMEOUT, keep_stream
from ..engine.connection import EngineError, explained, what
from ..fleet.commands import Commands, encoded, wanted_of
from ..fleet.outputs.forms import poll_messages
from ..fleet.outputs.topics import Levels
from ..fleet.readings import Reading
from ..tasks import end_tasks, finish
from .records import Connection
from .worker import Worker

if TYPE_CHECKING:
    from nats.aio.client import Client
    from nats.aio.msg import Msg

__all__ = ["CommandService", "Locations", "Stream"]

STREAM = "modbus-readings"

READINGS = "modbus.readings"
WRITE = "modbus.write"
WRITTEN = "modbus.written"

# Characters that have a meaning in subjects or topics, or are not allowed there.
_LEVELS = Levels(r"[\s.*>%/+#$\0]")

OVERHEAD = 200
"""More than the bytes of a message beside the names of its device, its point and its subject."""


class Stream:
    """
    An output: one message for each poll of a device, ``{"device": ..., "values": {NAME: {...}}}``.

    A poll that is larger than the server's largest message is several messages, which also have
    ``"part": 1, "parts": 3``.

    Args:
        client: a connected client.
        limits: the limits of the stream, as for `keep_stream`.
    """

    def __init__(self, client: Client, limits: Mapping[str, Any]) -> None:
        self.name: str = "nats"
        self._client = client
        self._limits = dict(limits)

    async def open(self) -> None:
        try:
            await keep_stream(self._client, STREAM, f"{READINGS}.>", self._limits)
        except EngineError as error:
            raise OSError(str(error)) from None
        self._js = self._client.jetstream(timeout=TIMEOUT)

    async def write(self, readings: Sequence[Reading]) -> None:
        client = self._client
        if not readings:
            return
        messages = list(_messages(readings, client.max_payload))
        try:
            with explained(STREAM):
                async with asyncio.timeout(TIMEOUT):
                    acknowledged = [
                        # Because of its id, the server drops a message that is sent again.
                        await self._js.publish_async(
                            subject, data, headers={"Nats-Msg-Id": f"{subject} {mark}"}
                        )
                        for subject, mark, data in messages
                    ]
                    await asyncio.gather(*acknowledged)
        except EngineError as error:
            raise ConnectionError(str(error)) from None

    async def close(self) -> None:
        pass


def _messages(readings: Sequence[Reading], largest: int) -> Iterator[tuple[str, str, bytes]]:
    """
    Yield the subject, a mark that no other message has, and the data of each message.

    Args:
        largest: the bytes that a message may have, with its headers.

    Raises:
        ReadingsRefused: a single reading has more bytes.
    """
    for (device, time), group in groupby(readings, lambda each: each.poll):
        subject = readings_of(device)
        room = largest - OVERHEAD - len(subject.encode())
        for names, data in poll_messages(list(group), room):
            yield subject, f"{time} {len(names)} {names[0]}", data


def readings_of(device: str) -> str:
    """Return the subject of the readings of a device."""
    return f"{READINGS}.{_LEVELS.spell(device)}"


def asked_about(subject: str) -> tuple[str, str] | None:
    """Return the device and the point of the subject of a write; None unless both are names."""
    device, _, point = subject.removeprefix(f"{WRITE}.").partition(".")
    names = _LEVELS.read(device), _LEVELS.read(point)
    return None if names[0] is None or names[1] is None else (names[0], names[1])


def written(device: str, point: str) -> str:
    """Return the subject of the outcomes of writes to a point."""
    return f"{WRITTEN}.{_LEVELS.spell(device)}.{_LEVELS.spell(point)}"


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
