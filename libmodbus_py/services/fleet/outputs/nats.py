"""
An output to NATS, for one machine. It needs nats-py (the extra ``nats``). Several machines that
share a fleet use `workers`.
"""

from __future__ import annotations

from typing import Any

from ....protocol.checks import integer, seconds
from ...engine.connection import connected, disconnect, parse_servers, places, shown
from ...engine.errors import EngineError
from ..buffer import MOST_KEPT
from .output import OutputError
from .stream import LIMITS, STREAM, Stream

__all__ = ["Nats"]

MOST_BYTES = 1 << 40


class Nats(Stream):
    """
    Publishes one message for each poll of a device to ``modbus.readings.DEVICE``, in a stream
    of JetStream, which keeps the messages for later consumers.

    Args:
        url: the URLs of the servers, separated by commas: "nats://192.0.2.1,nats://192.0.2.2".
            Credentials are taken from the environment, as by workers.
        max_age: seconds for which the stream keeps a message, 1 to 1e8.
        max_bytes: the most bytes that the stream keeps, 1 MiB or more; the oldest messages are
            deleted beyond.
        buffer: the most readings that wait for the servers; the oldest are dropped beyond.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    def __init__(
        self,
        url: str,
        *,
        max_age: float = LIMITS["max_age"],
        max_bytes: int = LIMITS["max_bytes"],
        buffer: int = MOST_KEPT,
    ) -> None:
        self.buffer: int = integer("buffer", buffer, 1, 10_000_000)
        self._servers = parse_servers(url)
        limits: dict[str, Any] = {
            "max_age": seconds("max_age", max_age, 1.0, 1e8),
            "max_bytes": integer("max_bytes", max_bytes, 1 << 20, MOST_BYTES),
        }
        super().__init__(None, limits)
        self.name: str = f"nats {shown(self._servers)}"
        self.exclusive: tuple[str, ...] = tuple(
            f"the stream {STREAM} of {place}" for place in places(self._servers)
        )

    async def open(self) -> None:
        await self.close()
        try:
            import nats  # noqa: F401
        except ImportError:
            raise OutputError("NATS needs nats-py: pip install 'libmodbus-py[nats]'") from None
        try:
            self._client = await connected(self._servers, name="libmodbus-py poll")
        except EngineError as error:
            raise OSError(str(error)) from None
        await super().open()

    async def close(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            await disconnect(client)
