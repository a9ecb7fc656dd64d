"""
The client of NATS between a worker and what servers and strangers send: malformed messages,
errors of the server, a server that offers no TLS when the connection is made again.
"""

import asyncio
import json
import ssl
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, closing, suppress
from typing import Any

import pytest

from fuzz.nats_servers import NatsServers
from libmodbus_py.services.engine.connection import EngineError, disconnect, open_connection
from tests.services.fleet.fleets import LONGEST, until
from tests.support import certificates
from tests.support.certificates import authority, save

pytest.importorskip("nats")

INFO = {"server_id": "x", "version": "2.10.0", "max_payload": 1000, "headers": True}


class Server:
    """
    As much of a NATS server as clients need to connect and subscribe. `greet`: returns the INFO of
    a connection with a number, and its TLS context or None. `heard`: the lines of each connection.
    """

    def __init__(self, greet: Callable[[int], tuple[dict[str, Any], ssl.SSLContext | None]]):
        self._greet = greet
        self.heard: list[list[bytes]] = []
        self.writers: list[asyncio.StreamWriter] = []
        self.tasks: list[asyncio.Task[Any] | None] = []

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        lines: list[bytes] = []
        info, context = self._greet(len(self.heard))
        self.heard.append(lines)
        self.writers.append(writer)
        self.tasks.append(asyncio.current_task())
        with closing(writer), suppress(OSError):
            writer.write(b"INFO " + json.dumps(info).encode() + b"\r\n")
            if context is not None:
                await writer.start_tls(context)
            while line := await reader.readline():
                lines.append(line)
                if line == b"PING\r\n":
                    writer.write(b"PONG\r\n")

    def say(self, data: bytes) -> None:
        self.writers[-1].write(data)


@asynccontextmanager
async def serving(
    greet: Callable[[int], tuple[dict[str, Any], ssl.SSLContext | None]],
) -> AsyncIterator[tuple[Server, int]]:
    server = Server(greet)
    listening = await asyncio.start_server(server.serve, "127.0.0.1", 0)
    try:
        yield server, listening.sockets[0].getsockname()[1]
    finally:
        listening.close()
        for writer in server.writers:
            writer.close()
        await asyncio.wait_for(asyncio.gather(*filter(None, server.tasks)), LONGEST)


@asynccontextmanager
async def connection(url: str, **environment: str) -> AsyncIterator[Any]:
    client = await open_connection([url], name="test", environment=environment)
    try:
        yield client
    finally:
        await disconnect(client)


@asynccontextmanager
async def subscribed() -> AsyncIterator[tuple[Server, Any, list[Any]]]:
    """A server, a client that subscribed to commands as number 1, and what that heard."""
    messages: list[Any] = []

    async def note(message: Any) -> None:
        messages.append(message)

    async with (
        serving(lambda number: (INFO, None)) as (server, port),
        connection(f"nats://127.0.0.1:{port}") as client,
    ):
        await client.subscribe("modbus.write.*.*", cb=note)
        await client.flush()
        yield server, client, messages


GOOD = b"MSG modbus.write.pump.level 1 2\r\nok\r\n"


@pytest.mark.parametrize(
    "message",
    [
        b"MSG modbus.write.\xff.level 1 2\r\nno\r\n",
        b"MSG modbus.write.pump.level 1 \xff\xfe 2\r\nno\r\n",
        b"MSG modbus.write.a\x0bb.level 1 2\r\nno\r\n",
        b"MSG modbus.write.a.b\x0b7 1 2\r\nno\r\n",
        b"HMSG modbus.write.pump.level 1 2 4\r\n\r\nno\r\n",
        b"HMSG modbus.write.pump.level 1 16 18\r\nNATS/1.0 \xff\xff\xff\r\n\r\nno\r\n",
        b"HMSG modbus.write.pump.level 1 4 6\r\n\x00\x00\x00\x00no\r\n",
        b"MSG modbus.write." + b"x" * 5000 + b".level 1 2\r\nno\r\n",
    ],
    ids=lambda message: repr(message[:30]),
)
async def test_a_malformed_message_affects_no_other_message(message: bytes) -> None:
    """Any client may send it to the subjects of commands, and all workers receive it."""

    async with subscribed() as (server, client, messages):
        server.say(message + GOOD)
        await until(lambda: any(message.data == b"ok" for message in messages))
        assert [message.data for message in messages] == [b"no", b"ok"]
        assert len(server.heard) == 1  # the connection was not lost
        assert client.is_connected


@pytest.mark.parametrize(
    "line",
    [
        b"-ERR 'Maximum Control Line Exceeded'\r\n",
        b"-ERR 'Authorization Violation'\r\n",
        b"-ERR 'User Authentication Expired'\r\n",
        b"-ERR\r\n",
        b"-ERR '\xff'\r\n",
        b"INFO []\r\n",
        b"MSG a b c\r\n",
        b"MSG a 1 99999999999\r\n",
        b"HTTP/1.1 400 Bad Request\r\n",
    ],
    ids=repr,
)
async def test_after_an_error_of_the_server_the_client_connects_again(line: bytes) -> None:
    async with subscribed() as (server, client, messages):
        server.say(line)
        await until(lambda: len(server.heard) == 2 and client.is_connected)
        await until(lambda: any(message.startswith(b"SUB modbus") for message in server.heard[1]))
        server.say(GOOD)
        await until(lambda: messages)


async def test_a_missing_permission_ends_no_connection() -> None:
    async with subscribed() as (server, _, messages):
        server.say(b"-ERR 'Permissions Violation for Publish to \"x\"'\r\n" + GOOD)
        await until(lambda: messages)
        assert len(server.heard) == 1


async def test_an_invalid_greeting_is_followed_by_another_attempt() -> None:
    """nats-py ends its attempts at an exception that it does not know, and stays lost for ever."""

    def greet(number: int) -> tuple[dict[str, Any], None]:
        return (INFO if number != 1 else {**INFO, "connect_urls": ["x" * 70_000]}), None

    async with serving(greet) as (server, port), connection(f"nats://127.0.0.1:{port}") as client:
        server.writers[-1].close()
        await until(lambda: len(server.heard) == 3 and client.is_connected)


MALFORMED = [
    b"PUB modbus.write.a\x0bb.level 1\r\n1\r\n",
    b"PUB modbus.write.\xff.level 1\r\n2\r\n",
    b"PUB modbus.write.pump.level _INBOX.\xff 1\r\n3\r\n",
    b"HPUB modbus.write.pump.level 2 3\r\n\r\n4\r\n",
    b"HPUB modbus.write.pump.level 16 17\r\nNATS/1.0 \xff\xff\xff\r\n\r\n5\r\n",
    b"PUB modbus.write.pump.level 1\r\n6\r\n",
]


async def test_malformed_messages_through_a_real_server_keep_the_connection() -> None:
    messages: list[bytes] = []

    async def note(message: Any) -> None:
        messages.append(message.data)

    with NatsServers(jetstream=False) as servers:
        port = servers.ports[0]
        async with connection(f"nats://127.0.0.1:{port}") as client:
            await client.subscribe("modbus.write.*.*", cb=note)
            await client.flush()
            _, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(b'CONNECT {"verbose":false,"headers":true}\r\n' + b"".join(MALFORMED))
            await until(lambda: len(messages) == len(MALFORMED))
            writer.close()
            assert messages == [b"1", b"2", b"3", b"4", b"5", b"6"]
            assert client.stats["reconnects"] == 0


LOGIN = {"NATS_USER": "u", "NATS_PASSWORD": "secret"}


def credentials(server: Server) -> list[bool]:
    """Return True if each connection was sent a CONNECT, which contains the password."""
    return [any(b"CONNECT" in line for line in lines) for lines in server.heard]


async def test_a_server_without_tls_is_sent_nothing() -> None:
    async with serving(lambda number: (INFO, None)) as (server, port):
        with pytest.raises(EngineError, match="does not support TLS; nothing was sent"):
            await open_connection([f"tls://127.0.0.1:{port}"], name="t", environment=LOGIN)
        assert server.heard
        assert not any(server.heard)


async def test_a_server_without_tls_is_sent_nothing_when_the_connection_is_made_again(tmp_path):
    ca = save(tmp_path, authority(), "ca")
    own = save(tmp_path, certificates.server(), "own")
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(own.cert, own.key)

    def greet(number: int) -> tuple[dict[str, Any], ssl.SSLContext | None]:
        return ({**INFO, "tls_required": True}, context) if number in (0, 2) else (INFO, None)

    async with serving(greet) as (server, port):
        async with connection(f"tls://127.0.0.1:{port}", NATS_CA=str(ca.cert), **LOGIN) as client:
            server.writers[-1].close()
            await until(lambda: len(server.heard) == 3 and client.is_connected)
        assert credentials(server) == [True, False, True]
        assert server.heard[1] == []
