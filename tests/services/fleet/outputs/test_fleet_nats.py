"""
Readings of one machine in a stream of a real nats-server, which dies and returns.
"""

from __future__ import annotations

import asyncio
import json

import pytest

from fuzz.nats_servers import NatsServers
from libmodbus_py import Server
from libmodbus_py.services.fleet.outputs.kinds import made
from tests.services.fleet.fleets import LONGEST, meter, polling, simulated

nats = pytest.importorskip("nats")


async def _next(subscription: object) -> dict[str, object]:
    message = await subscription.next_msg(LONGEST)  # type: ignore[attr-defined]
    await message.ack()
    told: dict[str, object] = json.loads(message.data)
    return told


def test_each_poll_is_a_message_and_those_of_a_pause_come_later() -> None:
    async def run(servers: NatsServers, url: str) -> None:
        output = made("nats", {"url": servers.urls})
        async with polling(meter("north.1", url), outputs=[output]) as (fleet, readings):
            given = fleet.statistics.outputs[output.name]
            while not given.written:  # the output makes the stream before it writes
                await asyncio.sleep(0.01)
            client = await nats.connect(servers.urls, max_reconnect_attempts=-1)
            stream = client.jetstream()
            heard = await stream.subscribe("modbus.readings.>", stream="modbus-readings")
            first = await _next(heard)
            assert first["device"] == "north.1"
            voltage = first["values"]["voltage"]  # type: ignore[index]
            assert (voltage["value"], voltage["unit"], voltage["quality"]) == (230.5, "V", "good")
            await client.close()

            servers.kill(0)
            before = len(readings)
            while len(readings) < before + 3:  # it polls on
                await asyncio.sleep(0.01)
            servers.start(0)
            async with asyncio.timeout(LONGEST):
                written = given.written
                while given.written == written:
                    await asyncio.sleep(0.05)

    with (
        NatsServers(1) as servers,
        Server(simulated()).background("tcp://127.0.0.1:0") as running,
    ):
        asyncio.run(run(servers, running.urls[0]))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"url": "mqtt://127.0.0.1"}, "must be nats://HOST"),
        ({"url": "nats://127.0.0.1", "max_age": 0}, "max_age must be in 1..1e.08 seconds, not 0"),
        ({"url": "nats://127.0.0.1", "max_bytes": 10}, "max_bytes must be in 1048576..109951162"),
        ({"url": "nats://127.0.0.1", "buffer": 0}, "buffer must be in 1..10000000, not 0"),
        ({}, "url is missing"),
    ],
)
def test_what_cannot_be_is_refused(keys: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        made("nats", keys)
