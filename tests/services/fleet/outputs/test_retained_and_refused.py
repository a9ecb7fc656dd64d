"""
A last value that the broker accepted once, and refuses after its restart.
"""

from __future__ import annotations

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from tests.services.fleet.fleets import until
from tests.services.fleet.outputs.brokers import Broker, heard_of, hearing, run
from tests.support.outputs import pumping


def reading(device: str, value: object, at: float = 0) -> Reading:
    return Reading(100.0 + at, device, "text", value, "", "good")


@pytest.mark.parametrize("qos", [0, 1])
def test_values_that_are_refused_are_forgotten_and_the_others_are_there(
    broker: Broker, qos: int, caplog: pytest.LogCaptureFixture
) -> None:
    async def go() -> None:
        async with pumping(Mqtt(broker.url, qos=qos)) as pump:
            long = "x" * 500
            pump.buffer.put(
                [reading(*each) for each in (("a", long), ("b", 1), ("c", long), ("d", 2))]
            )
            await until(lambda: pump.statistics.written == 4)
            broker.kill()
            await until(lambda: pump.statistics.trouble)
            broker.settings.append("max_packet_size 400")
            broker.start()
            async with hearing(broker, "modbus/+/text") as heard:
                pump.buffer.put([reading("e", 3, 1)])
                await until(lambda: pump.statistics.written == 5)
                await until(lambda: len({topic for topic, *_ in heard}) == 3)
            assert [heard_of(heard, f"modbus/{name}/text")[-1]["value"] for name in "bde"] == [
                1,
                2,
                3,
            ]

    run(go())
    told = [each.getMessage() for each in caplog.records if each.levelname == "ERROR"]
    own = [line.partition(": ")[2] for line in told if line.startswith("mqtt 127.0.0.1")]
    assert [each.partition(": ")[0] for each in sorted(own)] == [
        f"text of {name} is not published again" for name in "ac"
    ]


def test_a_broker_that_is_away_again_and_again_has_all_values_in_the_end(broker: Broker) -> None:
    async def go() -> None:
        async with pumping(Mqtt(broker.url)) as pump:
            pump.buffer.put([reading(name, name) for name in "abcdef"])
            await until(lambda: pump.statistics.written == 6)
            for _ in range(6):
                broker.kill()
                await until(lambda: pump.statistics.trouble)
                broker.start()
            async with hearing(broker, "modbus/+/text") as heard:
                await until(lambda: len({topic for topic, *_ in heard}) == 6)

    run(go())
