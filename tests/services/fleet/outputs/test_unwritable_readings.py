"""
Readings that an output can never take are told and dropped, and hold up no others, also if the
other side only ends the connection; all that fails for the moment is tried again.
"""

from __future__ import annotations

import asyncio
import errno
import json
from collections.abc import Callable, Sequence
from typing import Any, cast

import pytest

from libmodbus_py import Fleet
from libmodbus_py.fleet import OutputStatistics, Reading
from libmodbus_py.services.fleet.outputs.output import Output
from libmodbus_py.services.fleet.outputs.pump import Pump
from libmodbus_py.services.workers.messages import Stream
from tests.services.fleet.fleets import Peer, in_simulated_time, meter, simulated_run, until
from tests.simulation.engine import Engine
from tests.simulation.network import Network
from tests.support.cases import each_case
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


async def until_later(is_so: Callable[[], object]) -> None:
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
            await until_later(lambda: not pump.buffer or output.failed > 5)
            pump.buffer.put(polls(later))
            await until_later(lambda: not pump.buffer)
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
            await until_later(lambda: output.failed > 10)
            assert pump.statistics.dropped == 0
            output.refused = ""
            await until_later(lambda: not pump.buffer)
        return output

    assert simulated_run(go()).accepted == polls("a")


@in_simulated_time
async def test_the_suspected_poll_may_fall_out_of_a_full_buffer() -> None:
    output = Distant("x")
    async with pumping(output, most=4) as pump:
        pump.buffer.put(polls("x"))
        await until_later(lambda: output.failed > 3)
        pump.buffer.put(polls("bcd"))
        await until_later(lambda: not pump.buffer)
    assert {each.device for each in output.accepted} <= set("bcd")
    statistics = pump.statistics
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
            await until_later(lambda: pump.statistics.written + pump.statistics.dropped == 6)
        await client.close()
        return pump.statistics

    statistics = network.run(main)
    assert (statistics.written, statistics.dropped) == (4, 2)
    assert sorted({json.loads(data)["device"] for _, _, data in engine.stream}) == ["a", "b"]
