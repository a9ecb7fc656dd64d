"""
Readings that an output can never take are told and dropped, and hold up no others; all that fails
for the moment is tried again, and ends neither the fleet nor other outputs.
"""

from __future__ import annotations

import asyncio
import errno
import json
from collections.abc import Sequence
from typing import Any, cast

import pytest

from libmodbus_py import Fleet
from libmodbus_py.fleet import OutputStatistics, Reading
from libmodbus_py.services.fleet.outputs.output import Output
from libmodbus_py.services.fleet.outputs.pump import Pump
from libmodbus_py.services.workers.messages import Stream
from tests.services.fleet.fleets import Peer, meter, simulated_run, until
from tests.simulation.engine import Engine
from tests.simulation.network import Network
from tests.support.outputs import pumping


def reading(device: str, name: str, value: Any = 1, time: float = 100.0) -> Reading:
    return Reading(time, device, name, value, "V", "good")


class Picky:
    """An output that takes no reading of some devices, and reports each call of `write`."""

    name = "picky"

    def __init__(self, refused: Sequence[str] = (), error: Exception | None = None) -> None:
        self.refused = refused
        self.error = error or ValueError("too long")
        self.written: list[list[Reading]] = []
        self.opened = 0

    async def open(self) -> None:
        self.opened += 1

    async def write(self, readings: Sequence[Reading]) -> None:
        if any(each.device in self.refused for each in readings):
            raise self.error
        if readings:
            self.written.append(list(readings))

    async def close(self) -> None:
        pass


async def pumped(output: Output, readings: Sequence[Reading], most: int = 10_000) -> Pump:
    async with pumping(output, most) as pump:
        pump.buffer.put(readings)
        await until(lambda: not pump.buffer)
    return pump


def after_refusals(output: Picky, readings: list[Reading], count: int) -> OutputStatistics:
    """Write readings to an output that refuses so many times, then takes all; return the counts."""

    async def go() -> OutputStatistics:
        async with pumping(output) as pump:
            pump.buffer.put(readings)
            await until(lambda: pump.statistics.failures >= count)
            output.refused = ()
            await until(lambda: not pump.buffer)
        return pump.statistics

    return simulated_run(go())


def test_a_poll_that_can_never_be_written_is_dropped_and_the_others_are_written(
    caplog: pytest.LogCaptureFixture,
) -> None:
    output = Picky(refused=("b", "d"))
    readings = [reading(device, name) for device in "abcde" for name in ("one", "two")]
    pump = simulated_run(pumped(output, readings))
    assert [each.device for batch in output.written for each in batch] == list("aaccee")
    assert pump.statistics.dropped == 4
    assert pump.statistics.written == 6
    told = [each.getMessage() for each in caplog.records if each.levelname == "ERROR"]
    assert told == [f"picky: 2 readings of {each} are dropped: too long" for each in "bd"]


def test_readings_that_fail_once_for_whatever_reason_are_not_dropped() -> None:
    output = Picky(refused=("a",), error=RuntimeError("a bug"))

    statistics = after_refusals(output, [reading("a", "one")], 1)
    assert (statistics.dropped, statistics.written) == (0, 1)


def test_what_fails_for_the_moment_is_never_dropped() -> None:
    output = Picky(refused=("a",), error=OSError(errno.ENOSPC, "full"))

    statistics = after_refusals(output, [reading("a", "one"), reading("b", "one")], 5)
    assert (statistics.dropped, statistics.written) == (0, 2)


def test_an_output_that_raises_when_closed_is_opened_again() -> None:
    class Clumsy(Picky):
        async def close(self) -> None:
            raise RuntimeError("a bug")

    output = Clumsy(refused=("b",))
    pump = simulated_run(pumped(output, [reading(device, "one") for device in "abc"]))
    assert [each.device for batch in output.written for each in batch] == ["a", "c"]
    assert pump.statistics.dropped == 1


# --- a poll is one message ----------------------------------------------------------------------


def test_a_poll_is_never_divided_by_the_buffer() -> None:
    output = Picky()
    readings = [reading(device, f"{at}") for device in "abc" for at in range(1200)]
    simulated_run(pumped(output, readings))
    for batch in output.written:
        assert len(batch) % 1200 == 0
    assert sum(map(len, output.written)) == 3600


def test_a_reading_above_the_largest_message_stops_no_other_device() -> None:
    network = Network()
    engine = Engine(network)
    readings = [reading("a", "x"), reading("b", "long", "y" * 3000), reading("c", "x")]

    async def main() -> Pump:
        client = engine.client()
        client.max_payload = 2000
        async with pumping(Stream(cast(Any, client), {})) as pump:
            pump.buffer.put(readings)
            while pump.buffer:
                await asyncio.sleep(0.1)
        await client.close()
        return pump

    statistics = network.run(main).statistics
    assert (statistics.written, statistics.dropped) == (2, 1)
    assert [json.loads(data)["device"] for _, _, data in engine.stream] == ["a", "c"]


# --- one that fails is its own matter -----------------------------------------------------------


# --- once -------------------------------------------------------------------------------------


def test_once_waits_for_an_output_that_is_slow() -> None:
    class Slow(Picky):
        async def write(self, readings: Sequence[Reading]) -> None:
            await asyncio.sleep(60)
            await super().write(readings)

    async def go() -> Fleet:
        async with Peer() as peer:
            fleet = Fleet([meter("a", peer.url)], outputs=[Slow()])
            await fleet.run(once=True)
        return fleet

    statistics = simulated_run(go()).statistics.outputs["picky"]
    assert (statistics.written, statistics.dropped) == (3, 0)


def test_once_ends_after_a_failure_and_counts_what_was_lost() -> None:
    async def go() -> Fleet:
        async with Peer() as peer:
            output = Picky(refused=("a",), error=OSError("gone"))
            fleet = Fleet([meter("a", peer.url)], outputs=[output])
            await fleet.run(once=True)
        return fleet

    statistics = simulated_run(go()).statistics.outputs["picky"]
    assert (statistics.written, statistics.dropped) == (0, 3)
