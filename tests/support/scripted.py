"""
For tests of the asyncio client: their event loop, and a TCP server in it that does what
the test says.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any

from tests.simulation.loop import complaints_of

Write = Callable[[bytes], None]


def run(main: Coroutine[Any, Any, Any]) -> Any:
    """Run a test; whatever the loop complains of fails it."""
    with asyncio.Runner() as runner, complaints_of(runner.get_loop()) as complaints:
        result = runner.run(main)
    assert not complaints
    return result


class Scripted:
    """
    Cuts what comes into whole MBAP requests and hands each to `on_request`. `on_request`: called
    with a request and what writes to its client; None in place of an answer closes the connection.
    `requests`: all that came, oldest first; `connections`: how many were made.
    """

    def __init__(self, on_request: Callable[[bytes, Write], object]) -> None:
        self.on_request = on_request
        self.requests: list[bytes] = []
        self.connections = 0
        self.writers: list[asyncio.StreamWriter] = []
        self.port = 0

    @property
    def url(self) -> str:
        return f"tcp://127.0.0.1:{self.port}"

    def drop_all(self) -> None:
        """Close every connection, as a crash does."""
        for writer in self.writers:
            writer.transport.abort()
        self.writers.clear()

    @contextlib.asynccontextmanager
    async def serving(self, bound: socket.socket | None = None) -> AsyncIterator[Scripted]:
        """Serve; on a socket that is bound already, if one is given."""
        sock = bound or socket.create_server(("127.0.0.1", 0))
        server = await asyncio.start_server(self._serve, sock=sock)
        self.port = server.sockets[0].getsockname()[1]
        try:
            yield self
        finally:
            await all_accepted()
            server.close()
            self.drop_all()
            await asyncio.sleep(0)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        self.writers.append(writer)
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
            while True:
                header = await reader.readexactly(6)
                request = header + await reader.readexactly(int.from_bytes(header[4:], "big"))
                self.requests.append(request)
                self.on_request(request, writer.write)
        writer.transport.abort()


async def all_accepted() -> None:
    """
    Who was accepted just now is told to the server's callback in a few turns of the loop; if the
    server is closed before, asyncio forgets the socket.
    """
    for _ in range(10):
        await asyncio.sleep(0)


def answer(request: bytes, **changed: int) -> bytes:
    """Answer a read of one register with its address, with fields of the header changed."""
    pdu = b"\x03\x02" + request[8:10]
    fields = {
        "transaction": int.from_bytes(request[:2], "big"),
        "protocol": 0,
        "length": 1 + len(pdu),
    } | {name: value for name, value in changed.items() if name != "unit"}
    header = b"".join(value.to_bytes(2, "big") for value in fields.values())
    return header + bytes([changed.get("unit", request[6])]) + pdu


def echo(request: bytes, write: Write) -> None:
    """Answer at once."""
    write(answer(request))


def ignore(request: bytes, write: Write) -> None:
    """Answer nothing."""
