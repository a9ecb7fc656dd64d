"""
A topic of MQTT for each device: "online" while it answers, else "offline".
"""

from __future__ import annotations

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from libmodbus_py.services.fleet.outputs.mqtt_messages import DeviceStates
from libmodbus_py.services.fleet.outputs.topics import Topic
from tests.services.fleet.fleets import until
from tests.services.fleet.outputs.brokers import Broker, heard_of, hearing, run
from tests.support.cases import each_case
from tests.support.outputs import pumping

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
        known.note(changed, readings)
        found.append(changed["a"][1] if changed else None)
    assert found == states


def test_removed_devices_take_no_room() -> None:
    known = DeviceStates(Topic("device_status", TOPIC, ("device",)))
    for number in range(100):
        for letters in ("gg", "oo"):
            readings = poll(f"device {number}", letters)
            known.note(known.changed(readings), readings)
    assert (known.published, known._answered) == ({}, {})


def test_each_device_has_its_topic_also_after_a_restart_of_the_broker(broker: Broker) -> None:
    async def go() -> None:
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

    run(go())


@each_case(
    ("template", "message"),
    [
        ("states", "device_status must hold {device} once"),
        ("{device}/{name}", "device_status must hold {device} once"),
        ("{device}/{device}", "device_status must hold {device} once"),
        ("x{/{device}", "device_status: a brace belongs to no name"),
        ("modbus/{device}/state", "device_status must not be the topic of a reading"),
        ("modbus/state/{device}", "device_status must not be the topic of a reading"),
        ("{device}/a/b", "device_status must not be the topic of a reading"),
        ("modbus/{device}/x/set", "device_status must not be the topic of a reading"),
        ("modbus/{device}/x/set/result", "device_status must not be the topic of a reading"),
        ("modbus/{device}", "device_status must not be the topic of the status"),
        ("#/{device}", "device_status must be a topic without + and #"),
        (7, "device_status must be text"),
    ],
)
def test_topics_that_mean_something_else_are_refused(template: str, message: str) -> None:
    with pytest.raises((TypeError, ValueError)) as caught:
        Mqtt("mqtt://192.0.2.1", device_status=template)
    assert message in str(caught.value)
