"""Outputs under attack: bad answers, full disks, reloads while readings wait."""

import asyncio
import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from libmodbus_py import Fleet, Server
from libmodbus_py.fleet import Reading
from libmodbus_py.services import tasks
from libmodbus_py.services.fleet.outputs.line_file import CsvOutput, JsonOutput, LineFile
from libmodbus_py.services.fleet.outputs.output import OutputError
from tests.services.fleet.fleets import (
    Peer,
    good,
    in_simulated_time,
    meter,
    polling,
    simulated,
    until,
)
from tests.support.outputs import FakeOutput, output_writer


def poll(at: int, device: str = "a") -> list[Reading]:
    return [Reading(100.0 + at, device, name, at, "V", "good") for name in ("x", "y")]


class SmallDisk:
    """A disk on which there is room for so many bytes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, room: int) -> None:
        self.room = room
        self._write = os.write
        monkeypatch.setattr("libmodbus_py.services.fleet.outputs.line_file.os.write", self.write)

    def write(self, descriptor: int, data: bytes) -> int:
        if not self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        count = self._write(descriptor, data[: self.room])
        self.room -= count
        return count


@pytest.mark.parametrize("make", [JsonOutput, CsvOutput])
@pytest.mark.parametrize("room", [0, 10, 60, 200])
async def test_a_file_on_a_full_disk_has_whole_lines_and_each_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, make: Callable[[str], LineFile], room: int
) -> None:
    monkeypatch.setattr(tasks, "FIRST_PAUSE_S", 0.001)
    monkeypatch.setattr(tasks, "LONGEST_PAUSE_S", 0.01)
    disk = SmallDisk(monkeypatch, room)
    path = tmp_path / "readings"
    async with output_writer(make(str(path))) as writer:
        for at in range(5):
            writer.buffer.put_readings(poll(at))
        await until(lambda: writer.statistics.failures > 3)
        assert "No space left" in writer.statistics.trouble
        assert path.read_bytes()[-1:] in (b"", b"\n")
        disk.room = 1 << 20
        await until(lambda: writer.statistics.written == 10)
        assert writer.statistics.dropped == 0
    lines = path.read_text().splitlines()
    rows = lines if make is JsonOutput else lines[1:]
    assert len(rows) == len({*rows}) == 10


@in_simulated_time
async def test_a_permanent_failure_of_an_output_is_reported_to_readers(caplog) -> None:
    """`run` raises its error; in an `async with` nobody else would hear of it."""

    class Broken(FakeOutput):
        async def open_output(self) -> None:
            raise OutputError("MQTT needs aiomqtt")

    async with Peer() as peer:
        async with polling(meter("a", peer.url), outputs=[Broken("broken")]) as (fleet, readings):
            await until(lambda: len(readings) > 3)
            assert fleet.statistics.outputs["broken"].trouble == "MQTT needs aiomqtt"
        assert caplog.text.count("broken gets no more readings: MQTT needs aiomqtt") == 1
        caplog.clear()
        with pytest.raises(OutputError, match="MQTT needs aiomqtt"):
            await Fleet([meter("a", peer.url)], outputs=[Broken("broken")]).run()
        assert caplog.text == ""


@pytest.mark.parametrize("after", [[], ["b"], ["a"]], ids=["none", "another", "itself"])
@in_simulated_time
async def test_a_reload_discards_answers_of_removed_devices(after: list[str]) -> None:
    """A device is removed, replaced, or changed while it is asked: no reading of the former."""
    answers = asyncio.Event()

    async def slow(request: bytes) -> bytes | None:
        await answers.wait()
        return await good(request)

    async with Peer(slow) as peer:
        url = f"{peer.url}?timeout=30"
        async with polling(meter("a", url)) as (fleet, readings):
            await until(lambda: peer.requests)
            fleet.replace([meter(name, url, labels={"run": "2"}) for name in after])
            answers.set()
            await asyncio.sleep(1)
            assert {reading.device for reading in readings if reading.quality == "good"} == {*after}
            assert all(reading.labels == {"run": "2"} for reading in readings)
            statistics = fleet.statistics
            assert (statistics.devices, statistics.up) == (len(after), len(after))
            assert statistics.down == 0


async def test_metrics_can_be_scraped_while_a_fleet_is_read_again() -> None:
    """From another thread, as a server of metrics does."""
    prometheus = pytest.importorskip("prometheus_client")
    from libmodbus_py.services.integrations.prometheus import collect

    registry, is_over = prometheus.CollectorRegistry(), asyncio.Event()

    def scrape() -> int:
        count = 0
        while not is_over.is_set():
            assert b"modbus_fleet_devices" in prometheus.generate_latest(registry)
            count += 1
        return count

    units = range(1, 40)
    server = Server({unit: simulated() for unit in units})
    with server.background("tcp://127.0.0.1:0") as running:
        url = running.urls[0]
        one, other = (
            [meter(f"{kind}{unit}", url, unit=unit, labels={"kind": kind}) for unit in units]
            for kind in ("x", "y")
        )
        async with polling(*one) as (fleet, readings):
            collect(fleet, registry=registry)
            scraping = asyncio.create_task(asyncio.to_thread(scrape))
            for _ in range(30):
                for devices in (one, other):
                    fleet.replace(devices)
                    await asyncio.sleep(0.01)
            await until(lambda: len(readings) > 100)
            is_over.set()
            assert await scraping > 5
