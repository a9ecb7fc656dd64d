"""
What a real broker retains: the status of workers and devices, and last values after a restart; and
brokers that refuse a message, or die with it.
"""

from __future__ import annotations

import asyncio
import logging
import socket

import pytest

from libmodbus_py import Server
from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from libmodbus_py.services.fleet.outputs.mqtt_messages import DeviceStates
from libmodbus_py.services.fleet.outputs.topics import Topic
from tests.services.fleet.fleets import in_real_time, meter, polling, simulated, until
from tests.services.fleet.outputs.brokers import Broker, heard_of, hearing, publish, run
from tests.support.cases import each_case
from tests.support.outputs import pumping


@in_real_time
async def test_the_status_is_online_while_one_of_two_is_connected(broker: Broker) -> None:
    async with hearing(broker, "modbus/status") as heard:
        first, second = Mqtt(broker.url), Mqtt(broker.url)
        await first.open()
        await second.open()
        await until(lambda: len(heard) == 2)
        # The will of a worker that was killed, and the last word of one that ended.
        await publish(broker, "modbus/status", b"offline", retain=True)
        await until(lambda: heard_of(heard, "modbus/status")[2:] == ["offline"] + 2 * ["online"])
        await first.close()
        await until(lambda: heard_of(heard, "modbus/status")[5:] == ["offline", "online"])
        await second.close()
        await until(lambda: heard_of(heard, "modbus/status")[7:] == ["offline"])


def test_values_that_do_not_change_are_there_again_after_a_restart(broker: Broker) -> None:
    """mosquitto keeps nothing on the disk unless told to."""

    async def go(url: str) -> None:
        output = Mqtt(broker.url)
        device = meter("a", url, interval=0.05, on_change=True)
        async with polling(device, outputs=[output]) as (fleet, readings):
            counted = fleet.statistics.outputs[output.name]
            await until(lambda: counted.written == 3)
            broker.kill()
            await until(lambda: counted.trouble)
            broker.start()
            async with hearing(broker, "modbus/#") as heard:
                await until(lambda: len(heard) >= 4)
                assert "online" in heard_of(heard, "modbus/status")
                assert heard_of(heard, "modbus/a/voltage")[-1]["value"] == 230.5
            assert len(readings) == 3

    with Server(simulated()).background("tcp://127.0.0.1:0") as running:
        run(go(running.urls[0]))


def reading(device: str, value: object, at: float = 0) -> Reading:
    return Reading(100.0 + at, device, "text", value, "", "good")


@pytest.mark.parametrize("qos", [0, 1])
@in_real_time
async def test_last_values_at_which_the_broker_ends_connections_do_not_stop_others(
    broker: Broker, qos: int, caplog: pytest.LogCaptureFixture
) -> None:
    async with pumping(Mqtt(broker.url, qos=qos)) as pump:
        pump.buffer.put([reading("a", "x" * 500), reading("b", 1)])
        await until(lambda: pump.statistics.written == 2)
        broker.kill()
        await until(lambda: pump.statistics.trouble)
        broker.settings.append("max_packet_size 400")
        broker.start()
        async with hearing(broker, "modbus/+/text") as heard:
            pump.buffer.put([reading("c", 3, 1)])
            await until(lambda: pump.statistics.written == 3)
            await until(lambda: heard_of(heard, "modbus/c/text"))
    assert "ends connections at last values, which are left out" in caplog.text


@in_real_time
async def test_a_broker_that_is_away_again_and_again_has_all_values_in_the_end(
    broker: Broker,
) -> None:
    async with pumping(Mqtt(broker.url)) as pump:
        pump.buffer.put([reading(name, name) for name in "abcdef"])
        await until(lambda: pump.statistics.written == 6)
        for _ in range(6):
            broker.kill()
            await until(lambda: pump.statistics.trouble)
            broker.start()
        async with hearing(broker, "modbus/+/text") as heard:
            await until(lambda: len({topic for topic, *_ in heard}) == 6)


TOPIC = "modbus-devices/{device}"


def poll(device: str, qualities: str, at: float = 0) -> list[Reading]:
    """Return a reading for each letter: good, bad, down, offline."""
    names = {"g": "good", "b": "bad", "d": "down", "o": "offline"}
    return [
        Reading(100.0 + at, device, f"point {number}", None, "", names[letter])
        for number, letter in enumerate(qualities)
        if letter in names
    ]


@each_case(
    ("polls", "states"),
    [
        (["gg", "gg"], [True, None]),
        (["gg", "dd", "gg"], [True, False, True]),
        (["bb", "dd"], [True, False]),
        (["gd", "d-"], [True, False]),
        (["gg", "o-", "-o"], [True, None, False]),
        (["dd", "dd"], [False, None]),
        (["gg", "oo", "oo"], [True, False, False]),
    ],
)
def test_a_device_answers_while_a_point_of_it_is_read_or_refused(
    polls: list[str], states: list[bool | None]
) -> None:
    known = DeviceStates(Topic("device_status", TOPIC, ("device",)))
    found = []
    for letters in polls:
        readings = poll("a", letters)
        changed = known.changed(readings)
        assert known.changed(readings) == changed  # a write that failed is tried again
        known.keep(changed, readings)
        found.append(changed["a"][1] if changed else None)
    assert found == states


def test_a_device_with_another_label_has_another_topic() -> None:
    states = DeviceStates(Topic("device_status", "states/{label.site}/{device}", ("device",)))
    for site, sent in (
        ("x", [("states/x/a", b"online")]),
        ("x", []),
        ("y", [("states/x/a", b"offline"), ("states/y/a", b"online")]),
    ):
        labelled = [reading("a", 1)._replace(labels={"site": site})]
        changed = states.changed(labelled)
        assert list(states.messages(changed)) == sent
        states.keep(changed, labelled)


def test_removed_devices_take_no_room() -> None:
    known = DeviceStates(Topic("device_status", TOPIC, ("device",)))
    for number in range(100):
        for letters in ("gg", "oo"):
            readings = poll(f"device {number}", letters)
            known.keep(known.changed(readings), readings)
    assert (known.published, known._answered) == ({}, {})


@in_real_time
async def test_each_device_has_its_topic_also_after_a_restart_of_the_broker(broker: Broker) -> None:
    async with pumping(Mqtt(broker.url, device_status=TOPIC)) as pump:
        async with hearing(broker, "modbus-devices/+") as heard:
            pump.buffer.put([*poll("north/1", "gg"), *poll("south", "gg")])
            await until(lambda: len(heard) == 2)
            pump.buffer.put([*poll("north/1", "gg", 1), *poll("south", "dd", 1)])
            await until(lambda: len(heard) == 3)
        assert heard_of(heard, "modbus-devices/north%2F1") == ["online"]
        assert heard_of(heard, "modbus-devices/south") == ["online", "offline"]
        broker.kill()
        await until(lambda: pump.statistics.trouble)
        broker.start()
        async with hearing(broker, "modbus-devices/+") as heard:
            await until(lambda: len(heard) == 2)
        assert heard_of(heard, "modbus-devices/south") == ["offline"]
        assert heard_of(heard, "modbus-devices/north%2F1") == ["online"]


@pytest.fixture
def narrow(broker: Broker) -> Broker:
    """A broker that ends the connection on messages of more than 400 bytes."""
    broker.kill()
    broker.settings.append("max_packet_size 400")
    broker.start()
    return broker


def text(device: str, value: object, at: float) -> Reading:
    return Reading(100.0 + at, device, "text", value, "", "good")


@pytest.mark.parametrize("qos", [0, 1])
@in_real_time
async def test_a_message_on_which_the_broker_disconnects_is_dropped(
    narrow: Broker, qos: int
) -> None:
    async with (
        hearing(narrow, "modbus/+/text") as heard,
        pumping(Mqtt(narrow.url, qos=qos)) as pump,
    ):
        pump.buffer.put([text(*each) for each in (("a", 1, 0), ("b", "x" * 500, 1))])
        pump.buffer.put([text(*each) for each in (("c", 1, 2), ("b", "y", 3))])
        await until(lambda: pump.statistics.written == 3)
        assert (pump.statistics.dropped, len(pump.buffer)) == (1, 0)
        await until(lambda: len({topic for topic, *_ in heard}) == 3)
    assert heard_of(heard, "modbus/b/text")[-1]["value"] == "y"


@in_real_time
async def test_other_packages_log_no_errors_of_a_refused_message(
    narrow: Broker, caplog: pytest.LogCaptureFixture
) -> None:
    """The pump tells of it."""
    caplog.set_level(logging.DEBUG)
    async with pumping(Mqtt(narrow.url)) as pump:
        pump.buffer.put([text(*each) for each in (("a", 1, 0), ("b", "x" * 500, 0), ("c", 1, 0))])
        await until(lambda: pump.statistics.dropped and pump.statistics.written == 2)
    told = [each for each in caplog.records if each.levelno >= logging.INFO]
    # asyncio tells of callbacks that a busy machine makes slow.
    assert {each.name.partition(".")[0] for each in told} - {"asyncio"} == {"libmodbus_py"}
    assert any(each.name.endswith(".mqtt_connection.client") for each in caplog.records)


@in_real_time
async def test_a_connection_is_closed_if_nobody_waits_for_the_broker_any_more() -> None:
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


@in_real_time
async def test_readings_of_qos_0_are_sent_again_if_the_broker_died_before_it_had_them(
    broker: Broker,
) -> None:
    output = Mqtt(broker.url)
    await output.open()
    assert broker.process is not None
    broker.process.send_signal(19)  # SIGSTOP: what is sent stays in its socket
    writing = asyncio.create_task(output.write([text("a", 1, 0)]))
    await asyncio.wait([writing], timeout=0.2)
    broker.kill()
    with pytest.raises(ConnectionError):
        await writing
    await output.close()


@in_real_time
async def test_a_write_that_is_cancelled_publishes_no_longer(broker: Broker) -> None:
    output = Mqtt(broker.url, qos=1)
    await output.open()
    assert broker.process is not None
    broker.process.send_signal(19)  # SIGSTOP: it confirms nothing
    writing = asyncio.create_task(output.write([text("a", 1, 0)]))
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


@in_real_time
async def test_a_confirmation_waits_for_no_ack_of_tcp(broker: Broker) -> None:
    """Nagle's algorithm would hold back the request for it until the broker acknowledged others."""
    output = Mqtt(broker.url)
    await output.open()
    assert output._connection._client is not None
    connection = output._connection._client._client.socket()
    assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
    await output.close()
