"""
The clients, each as one that blocks; and peers that answer each address as its value.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from libmodbus_py import AsyncClient, Context, framing
from tests.support.fake import mbap

__all__ = ["ALL", "BLOCKING", "CLIENTS", "NATIVE", "Asking", "address_of", "answer", "asking"]

CLIENTS = ["native", "framed", "asyncio"]
"""A context that goes the short way, one that never does, and `AsyncClient`."""

ALL = pytest.mark.parametrize("kind", CLIENTS)
BLOCKING = pytest.mark.parametrize("kind", CLIENTS[:2])
NATIVE = pytest.mark.parametrize("native", [True, False])


class Asking:
    """
    Args:
        client: a context or an `AsyncClient`.
        run: gives what an awaitable gives; None for a context.
    """

    def __init__(self, client: Any, run: Callable[[Any], Any] | None) -> None:
        self.client = client
        self._run = run

    def __getattr__(self, name: str) -> Callable[..., Any]:
        method = getattr(self.client, name)
        if self._run is None:
            return method
        run = self._run

        async def call(*args: Any, **options: Any) -> Any:
            return await method(*args, **options)

        return lambda *args, **options: run(call(*args, **options))

    def for_unit(self, unit: int, **options: Any) -> Asking:
        return Asking(self.client.for_unit(unit, **options), self._run)

    def read(self, address: int) -> int:
        """Give the value of one holding register."""
        (value,) = self.__getattr__("read_holding_registers")(address, 1)
        return value


@contextlib.contextmanager
def asking(kind: str, url: str, **options: Any) -> Iterator[Asking]:
    """Make one of `CLIENTS`, connect it, and close it in the end."""
    if kind != "asyncio":
        chosen = {} if kind == "native" else {"native": False}
        with Context.from_url(url, **options, **chosen) as context:
            yield Asking(context, None)
        return
    with asyncio.Runner() as runner:

        async def make() -> AsyncClient:
            client = AsyncClient(url, **options)
            await client.connect()
            return client

        client = runner.run(make())
        try:
            yield Asking(client, runner.run)
        finally:
            runner.run(client.close())


def address_of(request: bytes, scheme: str) -> bytes:
    """Find the address in a request to read registers."""
    if scheme.startswith("ascii"):
        return bytes.fromhex(request[5:9].decode())
    at = 8 if scheme in ("tcp", "udp") else 2
    return request[at : at + 2]


def answer(request: bytes, scheme: str, unit: int | None = None) -> bytes:
    """Answer a read of one register with its address; as that unit, not the one asked."""
    pdu = b"\x03\x02" + address_of(request, scheme)
    if scheme in ("tcp", "udp"):
        return mbap(request, pdu) if unit is None else mbap(request, pdu, unit=unit)
    if scheme.startswith("ascii"):
        body = bytes([int(request[1:3], 16) if unit is None else unit]) + pdu
        return b":%s\r\n" % (body + bytes([framing.lrc(body)])).hex().upper().encode()
    body = bytes([request[0] if unit is None else unit]) + pdu
    return body + framing.crc16(body).to_bytes(2, "little")
