"""
An output to a stream of JetStream, which keeps the readings for later consumers.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

from ...engine.buckets import TIMEOUT, keep_stream
from ...engine.errors import EngineError, explained
from ..readings import Reading
from .forms import payload
from .subjects import READINGS, readings_of

if TYPE_CHECKING:
    from nats.aio.client import Client

__all__ = ["LIMITS", "STREAM", "Stream"]

STREAM = "modbus-readings"

LIMITS: dict[str, Any] = {"max_age": 86_400.0, "max_bytes": 1 << 30}
"""Limits of the stream unless the fleet file sets them, in seconds and bytes."""


class Stream:
    """
    An output: one message for each poll of a device, ``{"device": ..., "values": {NAME: {...}}}``.

    Args:
        client: a connected client; None if a subclass connects before `open`.
        limits: the limits of the stream; missing ones are taken from `LIMITS`.
    """

    def __init__(self, client: Client | None, limits: Mapping[str, Any]) -> None:
        self.name: str = "nats"
        self._client = client
        self._limits = {**LIMITS, **limits}

    async def open(self) -> None:
        assert self._client is not None
        try:
            await keep_stream(self._client, STREAM, f"{READINGS}.>", self._limits)
        except EngineError as error:
            raise OSError(str(error)) from None
        self._js = self._client.jetstream(timeout=TIMEOUT)

    async def write(self, readings: Sequence[Reading]) -> None:
        if not readings:
            return
        try:
            with explained(STREAM):
                async with asyncio.timeout(TIMEOUT):
                    acknowledged = [
                        # Because of its id, the server drops a message that is sent again.
                        await self._js.publish_async(
                            subject, data, headers={"Nats-Msg-Id": f"{subject} {mark}"}
                        )
                        for subject, mark, data in _messages(readings)
                    ]
                    await asyncio.gather(*acknowledged)
        except EngineError as error:
            raise OSError(str(error)) from None

    async def close(self) -> None:
        pass


def _messages(readings: Sequence[Reading]) -> Iterator[tuple[str, str, bytes]]:
    for (device, time), group in groupby(readings, lambda each: (each.device, each.time)):
        values = {each.name: payload(each) for each in group}
        told = json.dumps({"device": device, "values": values}, ensure_ascii=False)
        yield readings_of(device), f"{time} {len(values)} {next(iter(values))}", told.encode()
