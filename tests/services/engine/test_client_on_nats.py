"""
What a real nats-server hands on from one client to another, though it is malformed.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

import pytest

from fuzz.nats_servers import NatsServers
from libmodbus_py.services.engine.connection import connected, disconnect
from tests.services.fleet.fleets import until

pytest.importorskip("nats")

MALFORMED = [
    b"PUB modbus.write.a\x0bb.level 1\r\n1\r\n",
    b"PUB modbus.write.\xff.level 1\r\n2\r\n",
    b"PUB modbus.write.pump.level _INBOX.\xff 1\r\n3\r\n",
    b"HPUB modbus.write.pump.level 2 3\r\n\r\n4\r\n",
    b"HPUB modbus.write.pump.level 16 17\r\nNATS/1.0 \xff\xff\xff\r\n\r\n5\r\n",
    b"PUB modbus.write.pump.level 1\r\n6\r\n",
]


def test_all_messages_of_a_stranger_arrive_over_one_connection() -> None:
    heard: list[bytes] = []

    async def note(message: Any) -> None:
        heard.append(message.data)

    async def go(port: int) -> None:
        client: Any = await connected([f"nats://127.0.0.1:{port}"], name="t", environment={})
        try:
            await client.subscribe("modbus.write.*.*", cb=note)
            await client.flush()
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            await reader.readline()
            writer.write(b'CONNECT {"verbose":false,"headers":true}\r\n')
            for each in MALFORMED:
                writer.write(each)
            await until(lambda: len(heard) == len(MALFORMED))
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()
            assert heard == [b"1", b"2", b"3", b"4", b"5", b"6"]
            assert client.stats["reconnects"] == 0
        finally:
            await disconnect(client)

    with NatsServers(jetstream=False) as servers:
        asyncio.run(go(servers.ports[0]))
