"""
Servers that are not NATS, or one that is damaged: told in one line, and nothing of them stays open.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator

import pytest

from libmodbus_py.services.engine.connection import TIMES, connected
from libmodbus_py.services.engine.errors import EngineError

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


async def fails(said: bytes, closes: bool, patience: float) -> str:
    """Connect; return what is wrong with how that failed, if anything."""
    async with saying(said, closes=closes) as url:
        try:
            async with asyncio.timeout(patience):
                await connected([url], name="test")
        except TimeoutError:
            return "" if patience < 1 else "nobody gave up"
        except EngineError as error:
            is_right = str(error).startswith(f"{url}: ") and "Error" not in str(error)
            return "" if is_right else str(error)
    return "connected"


@pytest.mark.parametrize("closes", [False, True], ids=["stays", "closes"])
def test_what_ends_before_it_began_leaves_nothing_open(
    monkeypatch: pytest.MonkeyPatch, closes: bool
) -> None:
    """Return True if nats-py notices it, or a caller that connects waits no longer."""
    monkeypatch.setattr("libmodbus_py.services.engine.connection.TIMEOUT", 0.5)
    monkeypatch.setitem(TIMES, "connect_timeout", 0.5)
    cases = [(name, patience) for name in SAID for patience in (0.1, 30)]

    async def go() -> dict[tuple[str, float], str]:
        trials = (fails(SAID[name], closes, patience) for name, patience in cases)
        return dict(zip(cases, await asyncio.gather(*trials), strict=True))

    before = descriptors()
    found = asyncio.run(go())
    assert {case: wrong for case, wrong in found.items() if wrong} == {}
    assert descriptors() == before
