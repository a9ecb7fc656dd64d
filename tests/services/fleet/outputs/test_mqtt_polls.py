"""
Topics of MQTT without the name of a point: a message for each poll of a device.
"""

from __future__ import annotations

import json
from typing import Any

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs.forms import object_text, poll_messages
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from libmodbus_py.services.fleet.outputs.pump import Pump
from tests.services.fleet.fleets import in_real_time, until
from tests.services.fleet.outputs.brokers import Broker, heard_of, hearing, told
from tests.support.outputs import pumping

TOPIC = "plant/{device}"


def poll(device: str, at: float, **values: Any) -> list[Reading]:
    return [
        Reading(100.0 + at, device, name, value, "V", "good", "", round(at) + 1)
        for name, value in values.items()
    ]


async def written(pump: Pump, readings: list[Reading]) -> None:
    count = pump.statistics.written + len(readings)
    pump.buffer.put(readings)
    await until(lambda: pump.statistics.written == count)


@pytest.mark.parametrize("value", [1, -2.5, True, None, 'ü\x07"', [1, None], {"a": 1.5}, 1e300])
@pytest.mark.parametrize("number", [0, 7])
def test_the_text_of_a_reading_is_its_object(value: Any, number: int) -> None:
    reading = Reading(1e9, "a", "b", value, "°C", "bad", 'No "value"', number, {"site": "ü"})
    found = json.loads(object_text(reading))
    time = "2001-09-09T01:46:40.000Z"
    wanted = {"time": time, "value": value, "unit": "°C", "quality": "bad", "reason": 'No "value"'}
    assert found == {**wanted, **({"id": number} if number else {}), "labels": {"site": "ü"}}


@pytest.mark.parametrize("qos", [0, 1])
@in_real_time
async def test_each_poll_is_one_message_with_values_quality_reason_and_ids(
    broker: Broker, qos: int
) -> None:
    async with pumping(Mqtt(broker.url, topic=TOPIC, qos=qos, retain=False)) as pump:
        down = Reading(101.0, "a/b", "power", None, "W", "down", "ModbusTimeoutError", 9)
        async with hearing(broker, "plant/+") as heard:
            await written(pump, [*poll("a/b", 0, volts=230.5, amps=3), down, *poll("c", 1, x=1)])
            await until(lambda: len(heard) == 3)
        first, second = heard_of(heard, "plant/a%2Fb")
        time = "1970-01-01T00:01:40.000Z"
        good = {"time": time, "unit": "V", "quality": "good", "id": 1}
        assert first == {
            "device": "a/b",
            "values": {"volts": {"value": 230.5, **good}, "amps": {"value": 3, **good}},
        }
        assert second["values"]["power"] == json.loads(object_text(down))


@in_real_time
async def test_a_retained_message_has_the_last_values_of_all_points(broker: Broker) -> None:
    """The broker retains one message of a topic; with changes only, a poll has few values."""
    async with pumping(Mqtt(broker.url, topic=TOPIC)) as pump:
        await written(pump, poll("a", 0, x=1, y=2))
        await written(pump, [*poll("a", 1, y=3), *poll("a", 2, z=4)])
        gone = Reading(103.0, "a", "x", None, "V", "offline")
        async with hearing(broker, "plant/+") as heard:
            await until(lambda: heard)
            assert told(heard[-1][1]) == {"x": 1, "y": 3, "z": 4}
            await written(pump, [gone])
            await until(lambda: len(heard) == 2)
            assert told(heard[-1][1]) == {"x": None, "y": 3, "z": 4}
            await written(pump, poll("a", 4, y=5))
            await until(lambda: len(heard) == 3)
            assert told(heard[-1][1]) == {"y": 5, "z": 4}


def test_no_message_is_larger_than_asked_for() -> None:
    readings = poll("a", 0, **{f"p{at}": at for at in range(100)})
    for largest in range(1024, 1300):
        messages = list(poll_messages(readings, largest))
        assert max(len(data) for _, data in messages) <= largest
        assert sum(len(names) for names, _ in messages) == 100


@in_real_time
async def test_polls_above_the_largest_message_are_several(broker: Broker) -> None:
    broker.change("message_size_limit 2000")
    output = Mqtt(broker.url, topic=TOPIC, retain=False, max_message=2000)
    async with pumping(output) as pump:
        async with hearing(broker, "plant/+") as heard:
            await written(pump, poll("a", 0, **{f"point_{at}": at for at in range(100)}))
            await until(lambda: heard and len(heard) == heard[0][1]["parts"])
        messages = heard_of(heard, "plant/a")
        assert [each["part"] for each in messages] == list(range(1, len(messages) + 1))
        assert sum(len(each["values"]) for each in messages) == 100
