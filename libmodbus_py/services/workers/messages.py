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
id. Commands to the devices of a worker that has just ended are not answered: it may have carried
them out.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

from ..engine.buckets import TIMEOUT, keep_stream
from ..engine.connection import EngineError, engine_errors, explanation_of
from ..fleet.commands import Commands
from ..fleet.outputs.forms import poll_messages
from ..fleet.outputs.output import Output
from ..fleet.outputs.topics import Levels
from ..fleet.readings import Reading
from ..tasks import KeptTasks, end_tasks, finish
from .worker import Worker

if TYPE_CHECKING:
    from nats.aio.client import Client
    from nats.aio.msg import Msg

STREAM = "modbus-readings"

READINGS = "modbus.readings"
WRITE = "modbus.write"
WRITTEN = "modbus.written"

# Characters that have a meaning in subjects or topics, or are not allowed there.
_LEVELS = Levels(r"[\s.*>%/+#$\0]")

# More bytes than a message has beside the names of its device, its point and its subject.
OVERHEAD = 200


class Stream(Output):
    """
    An output: one message for each poll of a device, ``{"device": ..., "values": {NAME: {...}}}``.

    A poll that is larger than the server's largest message is several messages, which also have
    ``"part": 1, "parts": 3``. The limits of the stream are as for `keep_stream`.
    """

    def __init__(self, client: Client, limits: Mapping[str, Any]) -> None:
        self.name = "nats"
        self._client = client
        self._limits = dict(limits)

    async def open_output(self) -> None:
        try:
            await keep_stream(self._client, STREAM, f"{READINGS}.>", self._limits)
        except EngineError as error:
            raise OSError(str(error)) from None
        self._js = self._client.jetstream(timeout=TIMEOUT)

    async def write_readings(self, readings: Sequence[Reading]) -> None:
        messages = list(_messages(readings, self._client.max_payload))
        try:
            with engine_errors(STREAM):
                async with asyncio.timeout(TIMEOUT):
                    acknowledgements = [
                        # Because of its id, the server drops a message that is sent again.
                        await self._js.publish_async(
                            subject, data, headers={"Nats-Msg-Id": f"{subject} {mark}"}
                        )
                        for subject, mark, data in messages
                    ]
                    await asyncio.gather(*acknowledgements)
        except EngineError as error:
            raise ConnectionError(str(error)) from None


def _messages(readings: Sequence[Reading], largest: int) -> Iterator[tuple[str, str, bytes]]:
    """
    Yield the subject, a mark that no other message has, and the data of each message. A message may
    have `largest` bytes with its headers; a single reading that has more is refused.
    """
    for (device, time), group in groupby(readings, lambda reading: reading.poll):
        subject = f"{READINGS}.{_LEVELS.spell(device)}"
        room = largest - OVERHEAD - len(subject.encode())
        for names, data in poll_messages(list(group), room):
            yield subject, f"{time} {len(names)} {names[0]}", data


# --- commands -------------------------------------------------------------------------------------

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
    """Answers the commands that are published to ``modbus.write.DEVICE.POINT``."""

    def __init__(self, client: Client, commands: Commands, log: Callable[[str], None]) -> None:
        self._client = client
        self._commands = commands
        self._log = log
        self._tasks = KeptTasks()
        self._is_on = False

    def switch(self, is_on: bool) -> None:
        """Accept commands from now on, or none, not even received ones."""
        self._is_on = is_on
        for task in () if is_on else self._tasks:
            task.cancel()

    async def run(self) -> None:
        """Subscribe to commands, until cancelled; the client does so at each reconnection."""
        subscription = None
        try:
            while subscription is None:
                try:
                    subscription = await self._client.subscribe(f"{WRITE}.*.*", cb=self._receive)
                except Exception as error:
                    self._log(f"commands: {explanation_of(error)}")
                    await asyncio.sleep(PAUSE_S)
            await asyncio.Event().wait()
        finally:
            await end_tasks(list(self._tasks))
            if subscription is not None:
                await finish(subscription.unsubscribe(), PAUSE_S)

    async def _receive(self, message: Msg) -> None:
        if self._is_on and len(self._tasks) < MOST_WAITING:
            self._tasks.begin(self._answer(message))

    async def _answer(self, message: Msg) -> None:
        levels = message.subject.removeprefix(f"{WRITE}.").partition(".")
        device, point = _LEVELS.read(levels[0]), _LEVELS.read(levels[2])
        # Commands with other subjects are dropped: their sender would choose the subject to which
        # the outcome is published.
        if device is None or point is None:
            return
        outcome = await self._commands.answer(device, point, message.data)
        if outcome is None:
            return
        with contextlib.suppress(Exception):
            if _INBOX.fullmatch(message.reply):
                await self._client.publish(message.reply, outcome)
            subject = f"{WRITTEN}.{_LEVELS.spell(device)}.{_LEVELS.spell(point)}"
            await self._client.publish(subject, outcome)


def refusal(worker: Worker, device: str, now: float) -> str:
    """
    Return the reason to refuse a command to a device that this worker does not poll; "" if
    another worker answers the command, or none does.
    """
    if not worker.is_first(now):
        return ""
    slots = [
        connection.slot for connection in worker.view.connections if device in connection.names
    ]
    if not slots:
        return f"there is no device {device!r}"
    holder = worker.view.holder(slots[0])
    if holder is None or holder.state == "ended" or worker.is_mine(slots[0]):
        return f"no worker polls {device!r} now"
    return ""
