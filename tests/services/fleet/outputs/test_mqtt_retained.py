"""
What a real broker retains: the status of several workers, and last values after its restart, also
if it refuses one of them then.
"""

from __future__ import annotations

import pytest

from libmodbus_py import Server
from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from tests.services.fleet.fleets import meter, polling, simulated, until
from tests.services.fleet.outputs.brokers import Broker, heard_of, hearing, publish, run
from tests.support.outputs import pumping


def test_the_status_is_online_while_one_of_two_is_connected(broker: Broker) -> None:
    async def go() -> None:
        async with hearing(broker, "modbus/status") as heard:
            first, second = Mqtt(broker.url), Mqtt(broker.url)
            await first.open()
            await second.open()
            await until(lambda: len(heard) == 2)
            # The will of a worker that was killed, and the last word of one that ended.
            await publish(broker, "modbus/status", b"offline", retain=True)
            await until(
                lambda: heard_of(heard, "modbus/status")[2:] == ["offline"] + 2 * ["online"]
            )
            await first.close()
            await until(lambda: heard_of(heard, "modbus/status")[5:] == ["offline", "online"])
            await second.close()
            await until(lambda: heard_of(heard, "modbus/status")[7:] == ["offline"])

    run(go())


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
            async with hearing(broker, "modbus/a/+") as heard:
                await until(lambda: len(heard) >= 3)
                assert heard_of(heard, "modbus/a/voltage")[-1]["value"] == 230.5
            assert len(readings) == 3

    with Server(simulated()).background("tcp://127.0.0.1:0") as running:
        run(go(running.urls[0]))


def reading(device: str, value: object, at: float = 0) -> Reading:
    return Reading(100.0 + at, device, "text", value, "", "good")


@pytest.mark.parametrize("qos", [0, 1])
def test_last_values_at_which_the_broker_ends_connections_do_not_stop_others(
    broker: Broker, qos: int, caplog: pytest.LogCaptureFixture
) -> None:
    async def go() -> None:
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

    run(go())
    assert "ends connections at last values, which are left out" in caplog.text


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
