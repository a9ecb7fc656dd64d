"""
What a real broker retains: the status of workers and devices, and last values after a restart; and
brokers that refuse a message, or die with it.
"""

import asyncio
import logging
import signal
import socket
from typing import Any

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs.mqtt import DeviceStates, Mqtt
from libmodbus_py.services.fleet.outputs.topics import Topic
from tests.services.fleet.fleets import until
from tests.services.fleet.outputs.brokers import Broker, hearing, payloads, plain, publish
from tests.support.cases import each_case
from tests.support.outputs import output_writer


async def test_the_status_is_online_while_one_of_two_is_connected(broker: Broker) -> None:
    async with hearing(broker, "modbus/status") as messages:
        first, second = Mqtt(broker.url), Mqtt(broker.url)
        await first.open_output()
        await second.open_output()
        await until(lambda: len(messages) == 2)
        # The will of a worker that was killed, and the last word of one that ended.
        await publish(broker, "modbus/status", b"offline", retain=True)
        await until(lambda: payloads(messages, "modbus/status")[2:] == ["offline"] + 2 * ["online"])
        await first.close_output()
        await until(lambda: payloads(messages, "modbus/status")[5:] == ["offline", "online"])
        await second.close_output()
        await until(lambda: payloads(messages, "modbus/status")[7:] == ["offline"])


def reading(device: str, value: object, at: float = 0) -> Reading:
    return Reading(100.0 + at, device, "text", value, "", "good")


@pytest.mark.parametrize("qos", [0, 1])
async def test_last_values_that_make_a_broker_disconnect_do_not_stop_others(
    broker: Broker, qos: int, caplog: pytest.LogCaptureFixture
) -> None:
    async with output_writer(Mqtt(broker.url, qos=qos)) as writer:
        writer.buffer.put_readings([reading("a", "x" * 500), reading("b", 1)])
        await until(lambda: writer.statistics.written == 2)
        broker.settings.append("max_packet_size 400")
        await broker.restart(writer.statistics)
        async with hearing(broker, "modbus/+/text") as messages:
            writer.buffer.put_readings([reading("c", 3, 1)])
            await until(lambda: writer.statistics.written == 3)
            await until(lambda: payloads(messages, "modbus/c/text"))
    assert "ends connections at last values, which are left out" in caplog.text


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
def test_a_device_is_online_while_one_of_its_points_is_read_or_refused(polls, states) -> None:
    device_states = DeviceStates(Topic("device_status", TOPIC, ("device",)))
    messages = []
    for letters in polls:
        readings = poll("a", letters)
        changed = device_states.changed(readings)
        assert device_states.changed(readings) == changed  # a write that failed is tried again
        device_states.keep_states(changed, readings)
        messages.append(changed["a"][1] if changed else None)
    assert messages == states


def test_a_device_with_another_label_has_another_topic() -> None:
    states = DeviceStates(Topic("device_status", "states/{label.site}/{device}", ("device",)))
    for site, messages in (
        ("x", [("states/x/a", b"online")]),
        ("x", []),
        ("y", [("states/x/a", b"offline"), ("states/y/a", b"online")]),
    ):
        labelled = [reading("a", 1)._replace(labels={"site": site})]
        changed = states.changed(labelled)
        assert [message[:2] for message in states.messages(changed)] == messages
        states.keep_states(changed, labelled)


def test_states_of_removed_devices_take_no_memory() -> None:
    states = DeviceStates(Topic("device_status", TOPIC, ("device",)))
    for number in range(100):
        for letters in ("gg", "oo"):
            readings = poll(f"device {number}", letters)
            states.keep_states(states.changed(readings), readings)
    assert (states.published, states._answered) == ({}, {})


@pytest.mark.parametrize("qos", [0, 1])
@pytest.mark.parametrize(
    ("options", "polls", "retained"),
    [
        (
            {},
            [[reading("a", 1), reading("b", 2)], [reading("a", 3, 1)]],
            {"modbus/status": "online", "modbus/a/text": 3, "modbus/b/text": 2},
        ),
        (
            {"device_status": TOPIC},
            [poll("north/1", "gg"), poll("south", "gg"), poll("south", "dd", 1)],
            {"modbus-devices/north%2F1": "online", "modbus-devices/south": "offline"},
        ),
        (
            {"topic": "plant/{device}"},
            [poll("a", "gg"), poll("a", "-b", 1), poll("a", "o-", 2), [reading("a", 3, 3)]],
            {"plant/a": {"point 1": None, "text": 3}},
        ),
    ],
    ids=["values", "states of devices", "a message for each poll"],
)
async def test_retained_messages_are_published_again_after_each_reconnection(
    broker: Broker, caplog, options, polls, retained, qos
) -> None:
    """Nothing is read again: mosquitto keeps nothing on the disk unless told to."""

    async def heard_later() -> dict[str, tuple[Any, bool]]:
        async with hearing(broker, "#") as messages:
            await until(lambda: retained.keys() <= {topic for topic, *_ in messages})
        values = {topic: (plain(payload), is_retained) for topic, payload, is_retained in messages}
        return {topic: values[topic] for topic in retained}

    async with output_writer(Mqtt(broker.url, qos=qos, **options)) as writer:
        for readings in polls:
            count = writer.statistics.written + len(readings)
            writer.buffer.put_readings(readings)
            await until(lambda count=count: writer.statistics.written == count)  # type: ignore[misc]
        assert await heard_later() == {topic: (entry, True) for topic, entry in retained.items()}
        for _ in range(3):
            await broker.restart(writer.statistics)
        broker.kill()
        await until(lambda: writer.statistics.trouble)
        writer.buffer.put_readings([reading("c", 7, 9)])
        broker.start()
        topics = await heard_later()
        await until(lambda: writer.statistics.written == count + 1)
    assert {topic: entry for topic, (entry, _) in topics.items()} == retained
    assert writer.statistics.dropped == 0
    assert "accepts readings again" in caplog.text
    assert "Traceback" not in caplog.text


@pytest.fixture
def narrow(broker: Broker) -> Broker:
    """A broker that ends the connection on messages of more than 400 bytes."""
    broker.change("max_packet_size 400")
    return broker


@pytest.mark.parametrize("qos", [0, 1])
async def test_a_message_that_makes_the_broker_disconnect_is_dropped_and_logged_once(
    narrow: Broker, qos: int, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    async with (
        hearing(narrow, "modbus/+/text") as messages,
        output_writer(Mqtt(narrow.url, qos=qos)) as writer,
    ):
        writer.buffer.put_readings([reading(*item) for item in (("a", 1, 0), ("b", "x" * 500, 1))])
        writer.buffer.put_readings([reading(*entry) for entry in (("c", 1, 2), ("b", "y", 3))])
        await until(lambda: writer.statistics.written == 3)
        assert (writer.statistics.dropped, len(writer.buffer)) == (1, 0)
        await until(lambda: len({topic for topic, *_ in messages}) == 3)
    assert payloads(messages, "modbus/b/text")[-1]["value"] == "y"
    logged = [record for record in caplog.records if record.levelno >= logging.INFO]
    # asyncio tells of callbacks that a busy machine makes slow.
    assert {record.name.partition(".")[0] for record in logged} - {"asyncio"} == {"libmodbus_py"}
    assert any(record.name.endswith(".mqtt_connection.client") for record in caplog.records)


async def test_a_connection_is_closed_when_no_task_waits_for_the_broker() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        output = Mqtt(f"mqtt://127.0.0.1:{listening.getsockname()[1]}")
        opening = asyncio.create_task(output.open_output())
        loop = asyncio.get_running_loop()
        listening.setblocking(False)
        accepted, _ = await loop.sock_accept(listening)
        with accepted:
            await loop.sock_recv(accepted, 1000)
            opening.cancel()
            with pytest.raises(asyncio.CancelledError) as caught:  # it keeps objects in memory
                await opening
            assert caught.value
            assert await asyncio.wait_for(loop.sock_recv(accepted, 1), 10) == b""


async def test_readings_of_qos_0_are_sent_again_if_the_broker_died_before(
    broker: Broker,
) -> None:
    output = Mqtt(broker.url)
    await output.open_output()
    broker.send_signal(signal.SIGSTOP)  # messages stay in the socket of the broker
    writing = asyncio.create_task(output.write_readings([reading("a", 1)]))
    await asyncio.wait([writing], timeout=0.2)
    broker.kill()
    with pytest.raises(ConnectionError):
        await writing
    await output.close_output()


async def test_a_cancelled_write_publishes_nothing_more(broker: Broker) -> None:
    output = Mqtt(broker.url, qos=1)
    await output.open_output()
    broker.send_signal(signal.SIGSTOP)  # it confirms nothing
    writing = asyncio.create_task(output.write_readings([reading("a", 1)]))
    await asyncio.wait([writing], timeout=0.1)
    assert any("_publish_all" in repr(all_task) for all_task in asyncio.all_tasks())
    writing.cancel()
    with pytest.raises(asyncio.CancelledError):
        await writing
    for _ in range(10):  # turns of the loop
        await asyncio.sleep(0)
    tasks = [all_task for all_task in asyncio.all_tasks() if "_publish_all" in repr(all_task)]
    broker.send_signal(signal.SIGCONT)
    assert not tasks
    await output.close_output()
