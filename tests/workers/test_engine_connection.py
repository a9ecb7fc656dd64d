"""
Servers that are no NATS, or one that is not well: told in one line, and nothing of them stays open.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator

import pytest

from libmodbus_py.engine.connection import TIMES, connected
from libmodbus_py.engine.troubles import EngineError

pytest.importorskip("nats")

INFO = b'INFO {"server_id":"x","version":"2.9.0","max_payload":1000}\r\n'

# What it says as soon as somebody is connected, and then no more.
SAID = {
    "nothing": b"",
    "rubbish": b"HTTP/1.1 400 Bad Request\r\n\r\n",
    "no JSON": b"INFO {\r\n",
    "who it is": INFO,
    "that it wants TLS": b'INFO {"server_id":"x","version":"2.9.0","tls_required":true}\r\n',
    "that it wants a password": INFO + b"-ERR 'Authorization Violation'\r\n",
    "an old version": b'INFO {"server_id":"x","version":"2.1.0"}\r\nPONG\r\n',
}


@contextlib.asynccontextmanager
async def saying(said: bytes, *, closes: bool) -> AsyncIterator[str]:
    over = asyncio.Event()

    async def serve(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(said)
        if not closes:
            await over.wait()
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield f"nats://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    finally:
        over.set()
        server.close()
        await asyncio.sleep(0.05)


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


@pytest.mark.parametrize("patience", [0.1, 30])
@pytest.mark.parametrize("closes", [False, True], ids=["stays", "closes"])
@pytest.mark.parametrize("said", SAID)
def test_what_ends_before_it_began_leaves_nothing_open(
    monkeypatch: pytest.MonkeyPatch, said: str, closes: bool, patience: float
) -> None:
    """Whether nats-py sees it, or whoever wants to be connected waits no longer."""
    monkeypatch.setattr("libmodbus_py.engine.connection.PATIENCE", 0.5)
    monkeypatch.setitem(TIMES, "connect_timeout", 0.5)

    async def go() -> None:
        async with saying(SAID[said], closes=closes) as url:
            async with asyncio.timeout(patience):
                with pytest.raises(EngineError) as told:
                    await connected([url], name="test")
            assert str(told.value).startswith(f"{url}: ")
            assert "Error" not in str(told.value)

    before = descriptors()
    with contextlib.suppress(TimeoutError) if patience < 1 else contextlib.nullcontext():
        asyncio.run(go())
    assert descriptors() == before
