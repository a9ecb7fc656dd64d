"""
A server of HTTP that answers as a test tells it to, well or badly.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

Answer = bytes | list[bytes] | None
"""The bytes of an answer; a list to send again and again what stands last; None to close."""


class Last(bytes):
    """An answer, behind which the connection is closed."""


def answered(status: str, body: bytes = b"", *headers: str) -> bytes:
    told = "".join(f"{each}\r\n" for each in headers)
    head = f"HTTP/1.1 {status}\r\nContent-Length: {len(body)}\r\n{told}\r\n"
    return head.encode() + body


NO_CONTENT = answered("204 No Content")


@dataclass
class Received:
    """
    A request.

    Attributes:
        line: method and target.
        headers: by their names in lower case.
    """

    line: str
    headers: dict[str, str]
    body: bytes


@dataclass
class HttpServer:
    """
    Attributes:
        answers: one for each request; then 204.
        received: all requests.
    """

    answers: list[Answer] = field(default_factory=list)
    received: list[Received] = field(default_factory=list)
    url: str = ""

    async def talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while await self._serve(reader, writer):
                pass
        except (ConnectionError, asyncio.IncompleteReadError):
            pass
        finally:
            writer.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bool:
        first, *rest = (await reader.readuntil(b"\r\n\r\n")).decode().split("\r\n")
        headers = {
            name.lower(): value.strip()
            for name, _, value in (each.partition(":") for each in rest if each)
        }
        body = await reader.readexactly(int(headers.get("content-length", "0")))
        self.received.append(Received(first.removesuffix(" HTTP/1.1"), headers, body))
        answer = self.answers.pop(0) if self.answers else NO_CONTENT
        if answer is None:
            return False
        if isinstance(answer, bytes):
            writer.write(answer)
            await writer.drain()
            return not isinstance(answer, Last)
        for piece in answer[:-1]:
            writer.write(piece)
        while True:
            writer.write(answer[-1])
            await writer.drain()
            await asyncio.sleep(0)


@asynccontextmanager
async def serving(answers: Iterable[Answer] = ()) -> AsyncIterator[HttpServer]:
    made = HttpServer([*answers])
    talks: set[asyncio.Task[None]] = set()

    async def talk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        talks.add(task)
        await made.talk(reader, writer)

    server = await asyncio.start_server(talk, "127.0.0.1", 0)
    made.url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    try:
        yield made
    finally:
        server.close()
        for task in talks:
            task.cancel()
        await asyncio.gather(*talks, return_exceptions=True)
        await server.wait_closed()
