"""
A worker with its clock, its bucket and its fleet: in one process, in simulated time.
"""

from __future__ import annotations

import asyncio
import functools
import inspect
import json
import logging
import re
import socket
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from libmodbus_py import Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.services.engine.connection import EngineError, EngineGone
from libmodbus_py.services.fleet.config import checked, devices_to_json
from libmodbus_py.services.fleet.outputs.output import OutputError
from libmodbus_py.services.fleet.statistics import FleetStatistics
from libmodbus_py.services.workers import polling
from libmodbus_py.services.workers.decisions import step
from libmodbus_py.services.workers.polling import SAID_AGAIN_S, TIMEOUT_S, Polling
from libmodbus_py.services.workers.records import SETTINGS, Connection, FleetSettings
from libmodbus_py.services.workers.worker import Decision, Worker
from tests.services.workers.memory_engine import MemoryBucket, now, run, simulated

LEASE = 10.0
MAP = RegisterMap([Point("level", "holding_registers", 0)])


class Fleet:
    """
    Notes what it is to poll; see `libmodbus_py.Fleet`.

    Attributes:
        devices: what it polls.
        replaced: how often they changed.
        error: ends it, once it is set.
    """

    def __init__(
        self, *, outputs: Sequence[Any], journal: None, may_ask: Callable[[str], bool]
    ) -> None:
        self.outputs = outputs
        self.may_ask = may_ask
        self.statistics = FleetStatistics()
        self.devices: dict[str, DeviceConfig] = {}
        self.replaced = 0
        self.commands = SimpleNamespace(refusal=None)
        self.error: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    async def run(self) -> None:
        await self.error

    def take_back(self) -> None: ...

    def report_offline(self, devices: list[DeviceConfig]) -> None: ...

    def replace(self, devices: list[DeviceConfig], *, passed_on: set[str]) -> None:
        self.devices = {each.name: each for each in checked(devices)}
        self.replaced += 1


@pytest.fixture(autouse=True)
def _without_polls(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(polling, "Fleet", Fleet)


def connection(*names: str, host: int = 1) -> Connection:
    """A connection with devices of these names."""
    devices = [DeviceConfig(each, f"tcp://192.0.2.{host}", MAP) for each in names]
    return Connection("", devices[0].connection_key, 1.0, devices_to_json(devices))


def filled(*connections: Connection, **settings: Any) -> MemoryBucket:
    bucket = MemoryBucket()
    bucket.write(SETTINGS, FleetSettings(LEASE, **settings).encode())
    for each in connections:
        bucket.write(each.bucket_key, each.encode())
    return bucket


def made(bucket: MemoryBucket, settings: FleetSettings | None = None, **options: Any) -> Polling:
    given: Any = bucket
    return Polling(given.client, given, settings or FleetSettings(LEASE), clock=now, **options)


@asynccontextmanager
async def at_work(bucket: MemoryBucket, **options: Any) -> AsyncIterator[Polling]:
    """A worker that polls, and leaves at the end."""
    worker = made(bucket, **options)
    running = asyncio.create_task(worker.run())
    try:
        yield worker
    finally:
        worker.leave()
        await running


async def until(is_so: Callable[[], object], within: float = 60.0) -> float:
    """Wait for it in simulated time, and return the seconds that it took."""
    begun = now()
    async with asyncio.timeout(within):
        while not is_so():
            await asyncio.sleep(0.01)
    return now() - begun


def names(worker: Polling) -> list[str]:
    return sorted(worker.fleet.devices)


def members(bucket: MemoryBucket) -> list[dict[str, Any]]:
    """Return the last records that workers wrote of themselves."""
    return [
        json.loads(value)
        for key, (value, _) in bucket.values.items()
        if key.startswith("worker.") and value is not None
    ]


def of_pump(test: Callable[..., Awaitable[None]]) -> Callable[..., None]:
    """Make a test that is given a worker which polls a pump, and its bucket, in simulated time."""

    @functools.wraps(test)
    def whole(self: object, **fixtures: Any) -> None:
        async def main() -> None:
            bucket = filled(connection("pump"))
            async with at_work(bucket) as worker:
                await until(lambda: names(worker))
                await test(self, worker, bucket, **fixtures)

        run(main())

    own, _, _, *others = inspect.signature(test).parameters.values()
    whole.__signature__ = inspect.Signature([own, *others])  # type: ignore[attr-defined]
    return whole


class TestLife:
    @simulated
    async def test_a_worker_alone_polls_all_and_says_that_it_has_ended(self) -> None:
        pumps = connection("pump 1", "pump 2")
        bucket = filled(pumps, connection("valve", host=2))
        async with at_work(bucket) as worker:
            # It cannot know that nobody had them before, and waits for the longest lease.
            took = await until(lambda: len(names(worker)) == 3)
            assert took > LEASE
            assert worker._may_ask(pumps.key)
            assert not worker._may_ask("tcp:192.0.2.9:502")
            assert members(bucket)[0]["state"] == "here"
        assert members(bucket)[0]["state"] == "ended"
        assert not worker._may_ask(pumps.key)
        assert worker.worker.left
        assert bucket.watches == []

    def test_it_leaves_within_seconds_although_the_engine_is_gone(self) -> None:
        async def main() -> float:
            bucket = filled(connection("pump"))
            async with at_work(bucket) as worker:
                await until(lambda: names(worker))
                bucket.error = EngineGone("no server responds")
                begun = now()
            assert not worker.worker.left
            return now() - begun

        assert run(main()) == pytest.approx(TIMEOUT_S, abs=0.2)

    @simulated
    async def test_the_end_of_an_output_ends_it(self) -> None:
        bucket = filled(connection("pump"), commands=True)
        worker = made(bucket, FleetSettings(LEASE, commands=True))
        running = asyncio.create_task(worker.run())
        await until(lambda: names(worker))
        worker.fleet.error.set_exception(OutputError("nobody reads"))  # type: ignore[attr-defined]
        with pytest.raises(OutputError, match="nobody reads"):
            await running
        assert bucket.watches == []

    @simulated
    async def test_a_connection_that_is_closed_for_good_ends_it(self) -> None:
        """A worker that cannot reach NATS any more must not look alive."""
        bucket = filled(connection("pump"))
        worker = made(bucket)
        running = asyncio.create_task(worker.run())
        await until(lambda: names(worker))
        worker.engine_changed()
        await asyncio.sleep(1)
        assert not running.done()
        bucket.client.is_closed = True
        worker.engine_changed()
        with pytest.raises(EngineError, match="the connection to NATS was closed"):
            await running
        assert bucket.watches == []

    @simulated
    async def test_its_name_or_that_of_the_machine_becomes_a_key(self) -> None:
        names = ["hall 2.north", "x" * 90, ""]
        ids = [made(filled(), name=name).worker.id.split(".") for name in names]
        machine = re.sub(r"[^A-Za-z0-9_-]", "-", socket.gethostname())[:60]
        assert [id for id, _ in ids] == ["hall-2-north", "x" * 60, machine]
        assert len({nonce for _, nonce in ids}) == 3

    def test_a_lease_goes_on_while_the_machine_sleeps(self) -> None:
        default = inspect.signature(Polling).parameters["clock"].default
        before = time.clock_gettime(time.CLOCK_BOOTTIME)
        assert before <= default() <= time.clock_gettime(time.CLOCK_BOOTTIME)


class TestBucket:
    @pytest.mark.parametrize("missed", [True, False])
    @of_pump
    async def test_it_watches_again_when_something_was_missed_or_the_connection_changed(
        self, worker: Polling, bucket: MemoryBucket, missed: bool
    ) -> None:
        watched = bucket.watched
        if missed:
            bucket.watches[0].miss()
        else:
            worker.engine_changed()
        assert await until(lambda: bucket.watched > watched) < 1.0
        await asyncio.sleep(2.0)
        assert (bucket.watched, len(bucket.watches)) == (watched + 1, 1)
        # What is still there goes on to be polled.
        assert names(worker) == ["pump"]

    @of_pump
    async def test_it_watches_again_when_the_bucket_is_not_told_whole(
        self, worker: Polling, bucket: MemoryBucket
    ) -> None:
        bucket.is_mute = True
        worker.engine_changed()
        watched = bucket.watched
        await until(lambda: bucket.watched > watched)
        # Nothing has come of that watch: the one before still counts.
        assert not worker.worker.is_reading
        watch = bucket.watches[0]
        key, (value, revision) = next(iter(bucket.values.items()))
        watch.on_change(polling.Change(key, value, revision))
        assert worker.worker.is_reading
        assert 2.5 < await until(lambda: bucket.watches[:1] != [watch]) < TIMEOUT_S + 1
        bucket.is_mute = False
        await until(lambda: not worker.worker.is_reading)
        assert names(worker) == ["pump"]

    @pytest.mark.parametrize("lease", [0.5, LEASE])
    @simulated
    async def test_a_worker_alone_decides_as_often_as_it_renews_its_lease(
        self, lease: float, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        decided: list[float] = []

        def counted(worker: Worker, at: float, report: Any) -> Decision:
            decided.append(at)
            return step(worker, at, report)

        bucket = filled(connection("pump"))
        bucket.write(SETTINGS, FleetSettings(lease).encode())
        async with at_work(bucket, settings=FleetSettings(lease)) as worker:
            await until(lambda: names(worker))
            monkeypatch.setattr(polling, "step", counted)
            before = len(bucket.puts)
            await asyncio.sleep(10 * lease)
            assert len(bucket.puts) - before == pytest.approx(100, abs=2)
            assert len(decided) <= 210  # and when its value is seen

    @simulated
    async def test_an_engine_that_is_gone_ends_the_lease_and_is_told_once_a_minute(
        self, caplog: pytest.LogCaptureFixture
    ) -> None:
        bucket = filled(connection("pump"))
        async with at_work(bucket, name="a") as worker:
            await until(lambda: names(worker))
            assert caplog.messages == []
            bucket.error = EngineGone("no server responds")
            worker.engine_changed()
            key = connection("pump").key
            assert await until(lambda: not worker._may_ask(key)) < LEASE
            await asyncio.sleep(SAID_AGAIN_S - 15.0)
            gone = "the engine: no server responds"
            ended = "a: the lease has expired: NATS does not respond"
            assert sorted(caplog.messages) == [ended, gone]
            await asyncio.sleep(25.0)
            assert caplog.messages.count(gone) == 2
            bucket.error = None
            await until(lambda: worker._may_ask(key))
            await asyncio.sleep(1.0)
            assert caplog.messages[-1] == "a: the lease is valid again"

    @of_pump
    async def test_nothing_is_written_while_there_is_no_connection(
        self, worker: Polling, bucket: MemoryBucket
    ) -> None:
        """A value that is written then arrives late, when others consider the worker dead."""
        bucket.client.is_connected = False
        count = len(bucket.puts)
        await asyncio.sleep(LEASE)
        assert len(bucket.puts) == count


class TestDevices:
    @simulated
    async def test_what_cannot_be_read_is_told_and_polled_by_nobody(
        self, caplog: pytest.LogCaptureFixture
    ) -> None:
        pump, foreign = (DeviceConfig("pump", f"tcp://192.0.2.{at}", MAP) for at in (1, 77))
        bad = [
            Connection("", f"tcp:192.0.2.{host}:502", 1.0, devices)
            for host, devices in (
                (1, '{"devices": [{"name": "pump"}]}'),
                (2, devices_to_json([foreign])),
                (3, devices_to_json([pump, replace(foreign, name="fan")])),
            )
        ]
        # Of two devices of one name, one is polled.
        good = connection("valve", "fan", host=4), connection("fan", host=5)
        bucket = filled(*bad, *good)
        async with at_work(bucket) as worker:
            await until(lambda: names(worker))
            assert names(worker) == ["fan", "valve"]
            told = [text.partition(": ") for text in caplog.messages]
        assert sorted(each[0] for each in told) == [each.key for each in bad]
        assert {each[2][:32] for each in told} == {"its devices in the bucket are in"}


class TestReport:
    @of_pump
    async def test_it_reports_what_its_fleet_does(
        self, worker: Polling, bucket: MemoryBucket
    ) -> None:
        statistics = worker.fleet.statistics
        statistics.devices, statistics.up, statistics.down = 3, 2, 1
        for _ in range(40):
            statistics.polls += 5
            await asyncio.sleep(0.5)
        report = members(bucket)[0]["report"]
        assert report.pop("polls") == pytest.approx(10.0, rel=0.2)
        assert report == {"connections": 1, "devices": 3, "up": 2, "down": 1}
        await asyncio.sleep(3.0)
        assert members(bucket)[0]["report"]["polls"] == 0.0


@pytest.fixture(autouse=True)
def _logged(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, logger="libmodbus_py.services.workers")
