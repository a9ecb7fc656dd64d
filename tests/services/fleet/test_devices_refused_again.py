"""
A device whose every poll the other side refuses by ending the connection: what that costs others.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from libmodbus_py.services.fleet.outputs.pump import Pump
from tests.services.fleet.fleets import simulated_run
from tests.services.fleet.fleets import until as until_really
from tests.services.fleet.outputs.brokers import Broker, run
from tests.services.fleet.outputs.test_mqtt_status import text
from tests.services.fleet.outputs.test_unwritable_readings import Distant
from tests.services.fleet.outputs.test_unwritable_readings import until_later as until
from tests.support.outputs import pumping


def pumped(output: Distant, play: Callable[[Pump], Any]) -> Pump:
    """Let a pump write what `play` has it write, in simulated time."""

    async def go() -> Pump:
        async with pumping(output) as pump:
            await play(pump)
            await until(lambda: not len(pump.buffer))
        return pump

    return simulated_run(go())


def put(pump: Pump, devices: str, at: float) -> None:
    pump.buffer.put([text(device, 1, at) for device in devices])


def test_a_loss_after_a_refused_poll_drops_nothing() -> None:
    """That a poll was refused says nothing about the next ones, if the other side is away."""

    async def play(pump: Pump) -> None:
        put(pump, "abc", 0)
        await until(lambda: pump.statistics.dropped)
        await until(lambda: not len(pump.buffer))
        output.away = 2
        put(pump, "ac", 1)
        await until(lambda: not len(pump.buffer))

    output = Distant("b")
    pump = pumped(output, play)
    assert (pump.statistics.written, pump.statistics.dropped) == (4, 1)
    assert [each.device for each in output.accepted[-2:]] == ["a", "c"]


@pytest.mark.parametrize("devices", ["abc", "bac", "abcdefgh"])
def test_a_device_that_is_refused_again_costs_few_connections_and_no_time(devices: str) -> None:
    failed: list[int] = []
    took: list[float] = []

    async def play(pump: Pump) -> None:
        for at in range(20):
            before, begun = output.failed, asyncio.get_running_loop().time()
            put(pump, devices, at)
            await until(lambda at=at: pump.statistics.dropped == at + 1 and not len(pump.buffer))
            failed.append(output.failed - before)
            took.append(asyncio.get_running_loop().time() - begun)

    output = Distant("b")
    pump = pumped(output, play)
    assert pump.statistics.written == 20 * (len(devices) - 1)
    assert failed[0] <= 6
    assert max(failed[1:]) <= 2
    assert max(took[1:]) <= 0.3
    assert {each.device for each in output.accepted} == set(devices) - {"b"}


def test_a_device_that_is_accepted_again_is_believed_again() -> None:
    async def play(pump: Pump) -> None:
        put(pump, "abc", 0)
        await until(lambda: pump.statistics.dropped == 1)
        output.refused = ""
        put(pump, "abc", 1)
        await until(lambda: not len(pump.buffer))
        output.refused = "b"
        put(pump, "abc", 2)
        await until(lambda: output.failed > 6)
        output.refused = ""

    output = Distant("b")
    pump = pumped(output, play)
    assert pump.statistics.dropped == 1
    assert [each.device for each in output.accepted].count("b") == 2


def test_other_packages_log_no_errors_of_a_refused_message(
    broker: Broker, caplog: pytest.LogCaptureFixture
) -> None:
    """The pump tells of it."""
    broker.kill()
    broker.settings.append("max_packet_size 400")
    broker.start()

    async def go() -> None:
        async with pumping(Mqtt(broker.url)) as pump:
            pump.buffer.put(
                [text(*each) for each in (("a", 1, 0), ("b", "x" * 500, 0), ("c", 1, 0))]
            )
            await until_really(lambda: pump.statistics.dropped and pump.statistics.written == 2)

    with caplog.at_level(logging.DEBUG):
        run(go())
    told = [each for each in caplog.records if each.levelno >= logging.INFO]
    # asyncio tells of callbacks that a busy machine makes slow.
    assert {each.name.partition(".")[0] for each in told} - {"asyncio"} == {"libmodbus_py"}
    assert any(each.name.endswith(".mqtt_connection.client") for each in caplog.records)
