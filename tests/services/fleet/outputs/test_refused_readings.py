"""
A poll on which the other side ends the connection is told and dropped, and holds up no others;
one that is merely away loses nothing.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Sequence
from typing import Any, cast

import pytest

from libmodbus_py.fleet import OutputStatistics, Reading
from libmodbus_py.services.workers.messages import Stream
from tests.services.fleet.fleets import simulated_run
from tests.services.fleet.outputs.test_unwritable_readings import reading
from tests.simulation.engine import Engine
from tests.simulation.network import Network
from tests.support.cases import each_case
from tests.support.outputs import pumping


class Distant:
    """
    An output whose other side ends the connection on some devices, or on all messages.

    Attributes:
        refused: the devices.
        away: the number of writes that fail from now on, whatever is written.
        accepted: the readings that were written.
    """

    name = "distant"

    def __init__(self, refused: str = "", away: int = 0) -> None:
        self.refused = refused
        self.away = away
        self.accepted: list[Reading] = []
        self.failed = 0

    async def open(self) -> None:
        pass

    async def write(self, readings: Sequence[Reading]) -> None:
        if readings and self.away:
            self.away -= 1
            raise ConnectionError("the connection was lost")
        if any(each.device in self.refused for each in readings):
            self.failed += 1
            raise ConnectionError("the connection was lost")
        self.accepted += readings

    async def close(self) -> None:
        pass


async def until(is_so: Callable[[], object]) -> None:
    """Wait in simulated time: pauses are up to half a minute."""
    while not is_so():
        await asyncio.sleep(0.1)


def polls(devices: str) -> list[Reading]:
    """Return two readings for each poll of these devices, a poll a second."""
    return [
        reading(device, name, at, 100.0 + at)
        for at, device in enumerate(devices)
        for name in ("one", "two")
    ]


def written(output: Distant, devices: str, later: str = "") -> OutputStatistics:
    """Write polls until none waits or one is refused, then `later`; return the counts."""

    async def go() -> OutputStatistics:
        async with pumping(output) as pump:
            pump.buffer.put(polls(devices))
            await until(lambda: not pump.buffer or output.failed > 5)
            pump.buffer.put(polls(later))
            await until(lambda: not pump.buffer)
        return pump.statistics

    return simulated_run(go())


@each_case(
    ("devices", "refused"),
    [
        ("abcde", "c"),
        ("xabc", "x"),
        ("abx", "x"),
        ("axyzb", "xyz"),
        ("xyzwa", "xyzw"),
        ("xaxbxcxa", "x"),
        ("a" * 300 + "x" + "b" * 300, "x"),
    ],
)
def test_what_is_refused_is_dropped_and_all_others_are_written(devices: str, refused: str) -> None:
    output = Distant(refused)
    statistics = written(output, devices, later="ab")
    good = [each for each in polls(devices) if each.device not in refused]
    assert statistics.dropped == len(polls(devices)) - len(good)
    assert statistics.written == len(good) + 4
    assert {*map(str, output.accepted)} == {*map(str, [*good, *polls("ab")])}


def test_a_poll_that_is_dropped_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    written(Distant("b"), "abc")
    told = [each.getMessage() for each in caplog.records if each.levelname == "ERROR"]
    assert told == [
        "distant: 2 readings of b are dropped: others were accepted and these were not,"
        " several times: the connection was lost"
    ]


def test_an_output_of_one_device_writes_its_later_polls() -> None:
    class OnePoll(Distant):
        async def write(self, readings: Sequence[Reading]) -> None:
            self.refused = "a" if any(each.value == 1 for each in readings) else ""
            await super().write(readings)

    output = OnePoll()
    assert written(output, "aaaa").dropped == 2
    assert [each.value for each in output.accepted][-4:] == [2, 2, 3, 3]


def test_what_is_away_loses_nothing_however_long_and_ends_with_the_newest() -> None:
    devices = "abcabcab"
    for away in (*range(9), 20, 59):
        output = Distant(away=away)
        statistics = written(output, devices)
        assert (statistics.dropped, statistics.written) == (0, 16), away
        assert {*map(str, output.accepted)} == {*map(str, polls(devices))}
        newest = {each.device: each.value for each in output.accepted}
        assert newest == {each.device: each.value for each in polls(devices)}, away


def test_a_poll_that_waits_alone_is_kept() -> None:
    async def go() -> Distant:
        output = Distant("a")
        async with pumping(output) as pump:
            pump.buffer.put(polls("a"))
            await until(lambda: output.failed > 10)
            assert pump.statistics.dropped == 0
            output.refused = ""
            await until(lambda: not pump.buffer)
        return output

    assert simulated_run(go()).accepted == polls("a")


def test_the_suspected_poll_may_fall_out_of_a_full_buffer() -> None:
    async def go() -> OutputStatistics:
        output = Distant("x")
        async with pumping(output, most=4) as pump:
            pump.buffer.put(polls("x"))
            await until(lambda: output.failed > 3)
            pump.buffer.put(polls("bcd"))
            await until(lambda: not pump.buffer)
        assert {each.device for each in output.accepted} <= set("bcd")
        return pump.statistics

    statistics = simulated_run(go())
    assert statistics.written + statistics.dropped == 8
    assert statistics.written >= 4


def test_a_subject_that_nats_denies_holds_up_no_others() -> None:
    """A publish that the server denies is never acknowledged."""

    class Denied(Stream):
        async def open(self) -> None:
            await super().open()
            publish = self._js.publish_async

            async def denying(subject: str, *given: Any, **named: Any) -> Any:
                if subject.endswith(".x"):
                    return asyncio.get_running_loop().create_future()
                return await publish(subject, *given, **named)

            cast(Any, self._js).publish_async = denying

    network = Network()
    engine = Engine(network)

    async def main() -> OutputStatistics:
        client = engine.client()
        async with pumping(Denied(cast(Any, client), {})) as pump:
            pump.buffer.put(polls("axb"))
            await until(lambda: pump.statistics.written + pump.statistics.dropped == 6)
        await client.close()
        return pump.statistics

    statistics = network.run(main)
    assert (statistics.written, statistics.dropped) == (4, 2)
    assert sorted({json.loads(data)["device"] for _, _, data in engine.stream}) == ["a", "b"]
