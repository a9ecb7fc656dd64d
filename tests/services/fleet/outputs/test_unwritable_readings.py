"""
Readings that an output can never take are told and dropped, and hold up no others, also if the
other side only ends the connection; all that fails for the moment is tried again.
"""

import asyncio
import errno
import json
from collections.abc import Awaitable, Callable, Sequence
from typing import Any, cast

import pytest

from libmodbus_py import Fleet
from libmodbus_py.fleet import OutputStatistics, Reading
from libmodbus_py.services.fleet.outputs.writer import OutputWriter
from libmodbus_py.services.workers.messages import Stream
from tests.services.fleet.fleets import Peer, in_simulated_time, meter, simulated_run, until
from tests.simulation.engine import Engine
from tests.simulation.network import Network
from tests.support.cases import each_case
from tests.support.outputs import FakeOutput, output_writer, reading, write_readings

LOST = ConnectionError("the connection was lost")


def errors(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]


def polls(devices: str, first: int = 0) -> list[Reading]:
    """Return two readings for each poll of these devices, a poll a second."""
    return [
        reading(device, name, at, 100.0 + at)
        for at, device in enumerate(devices, first)
        for name in ("one", "two")
    ]


async def end_of(writer: OutputWriter) -> None:
    await until(lambda: not writer.buffer)


def played(
    output: FakeOutput, play: Callable[[OutputWriter], Awaitable[object]]
) -> OutputStatistics:
    """Let a writer write what `play` puts into its buffer, and return the counts."""

    async def go() -> OutputStatistics:
        async with output_writer(output) as writer:
            await play(writer)
            await end_of(writer)
        return writer.statistics

    return simulated_run(go())


def write_all(output: FakeOutput, devices: str, later: str = "") -> OutputStatistics:
    """Write polls until none waits or one is refused, then `later`; return the counts."""

    async def play(writer: OutputWriter) -> None:
        writer.buffer.put_readings(polls(devices))
        await until(lambda: not writer.buffer or output.failed > 5)
        writer.buffer.put_readings(polls(later))

    return played(output, play)


def test_a_poll_that_can_never_be_written_is_dropped_and_the_others_are_written(caplog) -> None:
    output = FakeOutput(refused=("b", "d"))
    statistics = write_all(output, "abcde")
    assert [reading.device for reading in output.accepted] == list("aaccee")
    assert (statistics.dropped, statistics.written) == (4, 6)
    assert errors(caplog) == [f"fake: 2 readings of {item} are dropped: too long" for item in "bd"]


@each_case(("error", "failures"), [(RuntimeError("a bug"), 1), (OSError(errno.ENOSPC, "full"), 5)])
def test_a_poll_that_fails_temporarily_is_not_dropped(error: Exception, failures: int) -> None:
    output = FakeOutput(refused=("a",), error=error)

    async def play(writer: OutputWriter) -> None:
        writer.buffer.put_readings(polls("ab"))
        await until(lambda: writer.statistics.failures >= failures)
        output.refused = ()

    statistics = played(output, play)
    assert (statistics.dropped, statistics.written) == (0, 4)


def test_an_output_that_raises_when_closed_is_opened_again() -> None:
    class Clumsy(FakeOutput):
        async def close_output(self) -> None:
            raise RuntimeError("a bug")

    output = Clumsy(refused=("b",))
    assert write_all(output, "abc").dropped == 2
    assert [reading.device for reading in output.accepted] == list("aacc")


def test_a_poll_is_never_split_by_the_buffer() -> None:
    output = FakeOutput()
    simulated_run(
        write_readings(output, [reading(device, f"{at}") for device in "abc" for at in range(1200)])
    )
    assert {len(batch) % 1200 for batch in output.batches} == {0}
    assert len(output.accepted) == 3600


@pytest.mark.parametrize(("is_gone", "counts"), [(False, (3, 0)), (True, (0, 3))])
@in_simulated_time
async def test_once_waits_for_a_slow_output_and_ends_after_a_failure(is_gone, counts) -> None:
    output = FakeOutput(refused=("a",), error=OSError("gone")) if is_gone else FakeOutput(next=[60])
    async with Peer() as peer:
        fleet = Fleet([meter("a", peer.url)], outputs=[output])
        await fleet.run(once=True)
    statistics = fleet.statistics.outputs["fake"]
    assert (statistics.written, statistics.dropped) == counts


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
def test_a_refused_poll_is_dropped_and_all_others_are_written(devices: str, refused: str) -> None:
    output = FakeOutput(refused=refused, error=LOST)
    statistics = write_all(output, devices, later="ab")
    good = [poll for poll in polls(devices) if poll.device not in refused]
    assert statistics.dropped == len(polls(devices)) - len(good)
    assert statistics.written == len(good) + 4
    assert {*map(str, output.accepted)} == {*map(str, [*good, *polls("ab")])}


def test_a_dropped_poll_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    write_all(FakeOutput(refused="b", error=LOST), "abc")
    assert errors(caplog) == [
        "fake: 2 readings of b are dropped: others were accepted and these were not,"
        " several times: the connection was lost"
    ]


def test_an_output_of_one_device_writes_its_later_polls() -> None:
    class OnePoll(FakeOutput):
        async def write_readings(self, readings: Sequence[Reading]) -> None:
            self.refused = "a" if any(reading.value == 1 for reading in readings) else ""
            await super().write_readings(readings)

    output = OnePoll(error=LOST)
    assert write_all(output, "aaaa").dropped == 2
    assert [reading.value for reading in output.accepted][-4:] == [2, 2, 3, 3]


@each_case("away", [*range(9), 20, 59])
def test_an_output_that_failed_for_a_while_gets_all_readings_and_the_newest_last(away: int) -> None:
    every = polls("abcabcab")
    output = FakeOutput(next=[LOST] * away)
    statistics = write_all(output, "abcabcab")
    assert (statistics.dropped, statistics.written) == (0, 16)
    assert {*map(str, output.accepted)} == {*map(str, every)}
    newest = {reading.device: reading.value for reading in output.accepted}
    assert newest == {entry.device: entry.value for entry in every}


def test_a_poll_that_waits_alone_is_not_dropped() -> None:
    output = FakeOutput(refused="a", error=LOST)

    async def play(writer: OutputWriter) -> None:
        writer.buffer.put_readings(polls("a"))
        await until(lambda: output.failed > 10)
        assert writer.statistics.dropped == 0
        output.refused = ""

    played(output, play)
    assert output.accepted == polls("a")


@in_simulated_time
async def test_the_suspected_poll_may_be_dropped_from_a_full_buffer() -> None:
    output = FakeOutput(refused="x", error=LOST, buffer=4)
    async with output_writer(output) as writer:
        writer.buffer.put_readings(polls("x"))
        await until(lambda: output.failed > 3)
        writer.buffer.put_readings(polls("bcd"))
        await end_of(writer)
    assert {reading.device for reading in output.accepted} <= set("bcd")
    assert writer.statistics.written + writer.statistics.dropped == 8
    assert writer.statistics.written >= 4


def test_a_lost_connection_after_a_refused_poll_drops_no_poll() -> None:
    """That a poll was refused says nothing about the next ones, if the other side is away."""
    output = FakeOutput(refused="b", error=LOST)

    async def play(writer: OutputWriter) -> None:
        writer.buffer.put_readings(polls("abc"))
        await until(lambda: writer.statistics.dropped)
        await end_of(writer)
        output.next = [LOST, LOST]
        writer.buffer.put_readings(polls("ac", first=3))

    statistics = played(output, play)
    assert (statistics.written, statistics.dropped) == (8, 2)
    assert [entry.device for entry in output.accepted[-4:]] == list("aacc")


@pytest.mark.parametrize("devices", ["abc", "bac", "abcdefgh"])
def test_a_device_that_is_refused_again_costs_few_connections_and_no_delay(devices: str) -> None:
    output = FakeOutput(refused="b", error=LOST)
    failed: list[int] = []
    took: list[float] = []

    async def play(writer: OutputWriter) -> None:
        for at in range(20):
            before, start = output.failed, asyncio.get_running_loop().time()
            writer.buffer.put_readings(
                [reading(device, "one", 1, 100.0 + at) for device in devices]
            )
            await until(lambda at=at: writer.statistics.dropped == at + 1 and not writer.buffer)
            failed.append(output.failed - before)
            took.append(asyncio.get_running_loop().time() - start)

    assert played(output, play).written == 20 * (len(devices) - 1)
    assert failed[0] <= 6
    assert max(failed[1:]) <= 2
    assert max(took[1:]) <= 0.3
    assert {reading.device for reading in output.accepted} == set(devices) - {"b"}


def test_a_device_that_is_accepted_again_is_no_longer_suspected() -> None:
    output = FakeOutput(refused="b", error=LOST)

    async def play(writer: OutputWriter) -> None:
        writer.buffer.put_readings(polls("abc"))
        await until(lambda: writer.statistics.dropped)
        output.refused = ""
        writer.buffer.put_readings(polls("abc", first=3))
        await end_of(writer)
        output.refused = "b"
        writer.buffer.put_readings(polls("abc", first=6))
        await until(lambda: output.failed > 6)
        output.refused = ""

    assert played(output, play).dropped == 2
    assert [reading.device for reading in output.accepted].count("b") == 4


class Denied(Stream):
    """Its server denies the subject of x: such a publish is never acknowledged."""

    async def open_output(self) -> None:
        await super().open_output()
        publish = self._js.publish_async

        async def denying(subject: str, *arguments: Any, **options: Any) -> Any:
            if subject.endswith(".x"):
                return asyncio.get_running_loop().create_future()
            return await publish(subject, *arguments, **options)

        cast(Any, self._js).publish_async = denying


@each_case(("kind", "value"), [(Denied, 1), (Stream, "y" * 3000)])
def test_a_poll_that_nats_denies_or_finds_too_large_delays_no_others(kind, value) -> None:
    network = Network()
    engine = Engine(network)

    async def go() -> OutputStatistics:
        client = engine.client()
        client.max_payload = 2000
        readings = [reading("a", "one"), reading("x", "one", value, 101.0), reading("b", "one")]
        writer = await write_readings(kind(cast(Any, client), {}), readings)
        await client.close()
        return writer.statistics

    statistics = simulated_run(go(), network)
    assert (statistics.written, statistics.dropped) == (2, 1)
    assert sorted(json.loads(data)["device"] for _, _, data in engine.stream) == ["a", "b"]
