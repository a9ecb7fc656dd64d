"""
The stream of JetStream that keeps the readings for later consumers, and the subjects of messages.

For an MQTT client of the NATS server the subjects are topics, with / in place of each dot.

::

    modbus.readings.DEVICE              the readings of a device
    modbus.write.DEVICE.POINT           a value to write; the reply contains the outcome
    modbus.written.DEVICE.POINT         the outcome, for clients that cannot receive replies
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

from ..engine.buckets import TIMEOUT, keep_stream
from ..engine.connection import EngineError, explained
from ..fleet.outputs.forms import poll_messages
from ..fleet.outputs.topics import Levels
from ..fleet.readings import Reading

if TYPE_CHECKING:
    from nats.aio.client import Client

__all__ = ["WRITE", "Stream", "asked_about", "written"]

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
