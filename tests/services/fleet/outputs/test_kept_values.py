"""
What outputs keep of readings: the last value of each point, and whether each device answers.
"""

from __future__ import annotations

import asyncio

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs.line_file import JsonOutput
from libmodbus_py.services.fleet.outputs.mqtt_messages import DeviceStates
from libmodbus_py.services.fleet.outputs.topics import Topic
from libmodbus_py.services.fleet.statistics import LastValues
from tests.services.fleet.fleets import meter


def reading(device: str, name: str = "v", quality: str = "good", value: float = 1.0) -> Reading:
    return Reading(1.0, device, name, value, "V", quality)  # type: ignore[arg-type]


class TestLastValues:
    def test_the_last_reading_of_each_point_is_kept(self) -> None:
        values = LastValues()
        values.describe({name: meter(name, "tcp://192.0.2.1") for name in ("a", "b")})
        told = [reading("a"), reading("a", "w"), reading("b"), reading("a", value=2.0)]
        asyncio.run(values.write(told))
        assert values.statistics.by_name == {
            ("a", "v"): told[3],
            ("a", "w"): told[1],
            ("b", "v"): told[2],
        }
        asyncio.run(values.write([reading("a", quality="offline"), reading("b", quality="down")]))
        assert sorted(values.statistics.by_name) == [("a", "w"), ("b", "v")]
        values.describe({"a": meter("a", "tcp://192.0.2.1")})
        assert sorted(values.statistics.by_name) == [("a", "w")]

    def test_a_removed_device_has_no_values(self) -> None:
        values = LastValues()
        asyncio.run(values.write([reading("gone"), reading("gone", quality="offline")]))
        assert values.statistics.by_name == {}


TOPIC = Topic("device_status", "states/{label.site}/{device}", ("device",))


class TestDeviceStates:
    def test_what_was_not_published_is_told_again(self) -> None:
        states = DeviceStates(TOPIC)
        changed = states.changed([reading("a")])
        assert changed == {"a": ("states/unknown/a", True)}
        assert states.changed([reading("a")]) == changed
        states.keep(changed, [reading("a")])
        assert states.changed([reading("a")]) == {}

    def test_a_device_with_another_label_has_another_topic(self) -> None:
        states = DeviceStates(TOPIC)
        for site, sent in (
            ("x", [("states/x/a", b"online")]),
            ("x", []),
            ("y", [("states/x/a", b"offline"), ("states/y/a", b"online")]),
        ):
            labelled = [reading("a")._replace(labels={"site": site})]
            changed = states.changed(labelled)
            assert list(states.messages(changed)) == sent
            states.keep(changed, labelled)


def test_only_the_standard_output_wants_no_earlier_readings() -> None:
    assert JsonOutput("-").is_live is True
    assert JsonOutput("readings.json").is_live is False
    assert LastValues().is_live is True
