"""
Real brokers that refuse one message, and accept all others.
"""

from __future__ import annotations

import asyncio
import socket

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from tests.services.fleet.fleets import until
from tests.services.fleet.outputs.brokers import Broker, heard_of, hearing, run
from tests.support.outputs import pumping


@pytest.fixture
def narrow(broker: Broker) -> Broker:
    """A broker that ends the connection on messages of more than 400 bytes."""
    broker.kill()
    broker.settings.append("max_packet_size 400")
    broker.start()
    return broker


def poll(device: str, value: object, at: float) -> Reading:
    return Reading(100.0 + at, device, "text", value, "", "good")


@pytest.mark.parametrize("qos", [0, 1])
def test_a_message_on_which_the_broker_disconnects_is_dropped(narrow: Broker, qos: int) -> None:
    async def go() -> None:
        async with (
            hearing(narrow, "modbus/+/text") as heard,
            pumping(Mqtt(narrow.url, qos=qos)) as pump,
        ):
            pump.buffer.put([poll(*each) for each in (("a", 1, 0), ("b", "x" * 500, 1))])
            pump.buffer.put([poll(*each) for each in (("c", 1, 2), ("b", "y", 3))])
            await until(lambda: pump.statistics.written == 3)
            assert (pump.statistics.dropped, len(pump.buffer)) == (1, 0)
            await until(lambda: len({topic for topic, *_ in heard}) == 3)
        assert heard_of(heard, "modbus/b/text")[-1]["value"] == "y"

    run(go())


def test_a_connection_is_closed_if_nobody_waits_for_the_broker_any_more() -> None:
    async def go() -> None:
        with socket.create_server(("127.0.0.1", 0)) as listening:
            output = Mqtt(f"mqtt://127.0.0.1:{listening.getsockname()[1]}")
            opening = asyncio.create_task(output.open())
            loop = asyncio.get_running_loop()
            listening.setblocking(False)
            accepted, _ = await loop.sock_accept(listening)
            with accepted:
                await loop.sock_recv(accepted, 1000)
                opening.cancel()
                with pytest.raises(asyncio.CancelledError) as left:  # which keeps all that it names
                    await opening
                assert left.value
                assert await asyncio.wait_for(loop.sock_recv(accepted, 1), 10) == b""

    run(go())


def test_readings_of_qos_0_are_sent_again_if_the_broker_died_before_it_had_them(
    broker: Broker,
) -> None:
    async def go() -> None:
        output = Mqtt(broker.url)
        await output.open()
        assert broker.process is not None
        broker.process.send_signal(19)  # SIGSTOP: what is sent stays in its socket
        writing = asyncio.create_task(output.write([poll("a", 1, 0)]))
        await asyncio.wait([writing], timeout=0.2)
        broker.kill()
        with pytest.raises(ConnectionError):
            await writing
        await output.close()

    run(go())


def test_a_write_that_is_cancelled_publishes_no_longer(broker: Broker) -> None:
    async def go() -> None:
        output = Mqtt(broker.url, qos=1)
        await output.open()
        assert broker.process is not None
        broker.process.send_signal(19)  # SIGSTOP: it confirms nothing
        writing = asyncio.create_task(output.write([poll("a", 1, 0)]))
        await asyncio.wait([writing], timeout=0.1)
        assert any("_publish_all" in repr(each) for each in asyncio.all_tasks())
        writing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await writing
        for _ in range(10):  # turns of the loop
            await asyncio.sleep(0)
        left = [each for each in asyncio.all_tasks() if "_publish_all" in repr(each)]
        broker.process.send_signal(18)  # SIGCONT
        assert not left
        await output.close()

    run(go())


def test_a_confirmation_waits_for_no_ack_of_tcp(broker: Broker) -> None:
    """Nagle's algorithm would hold back the request for it until the broker acknowledged others."""

    async def go() -> None:
        output = Mqtt(broker.url)
        await output.open()
        assert output._connection._client is not None
        connection = output._connection._client._client.socket()
        assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        await output.close()

    run(go())
