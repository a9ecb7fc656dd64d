"""Outputs that are slow, full, gone or wrong: polling goes on, and what was lost is counted."""

import asyncio
import errno
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Fleet
from libmodbus_py.services import tasks
from libmodbus_py.services.fleet.outputs.line_file import JsonOutput
from libmodbus_py.services.fleet.outputs.output import Output, OutputError
from tests.services.fleet.fleets import Peer, in_simulated_time, meter, real_peer, until
from tests.support.outputs import FakeOutput


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Outputs are tried again sooner."""
    monkeypatch.setattr(tasks, "FIRST_PAUSE_S", 0.02)
    monkeypatch.setattr(tasks, "FINISHING_S", 0.2)


async def polled(
    output: Output, is_so: Any, interval: float = 0.02, kind: Callable[[], Any] = Peer
) -> Fleet:
    async with kind() as peer:
        fleet = Fleet([meter("a", peer.url, interval=interval)], outputs=[output])
        async with fleet:
            await until(lambda: is_so(fleet))
    return fleet


@in_simulated_time
async def test_a_slow_output_loses_the_oldest_readings_and_delays_no_other() -> None:
    output = FakeOutput(next=[1.5], buffer=20)
    fleet = await polled(output, lambda fleet: fleet.statistics.polls > 30)
    statistics = fleet.statistics.outputs["fake"]
    assert statistics.dropped > 10
    assert len(output.accepted) + statistics.dropped == fleet.statistics.readings
    # Those that were taken before it was slow, and the last ones.
    assert len(output.accepted) <= 3 + 2 * output.buffer


@in_simulated_time
async def test_an_output_that_fails_is_opened_again_and_loses_no_reading(caplog: Any) -> None:
    no = OSError(errno.EIO, "no")
    output = FakeOutput(next=[no, no, 0, RuntimeError("a bug")])
    fleet = await polled(output, lambda fleet: fleet.statistics.polls > 60, interval=0.05)
    # Twice as long after each failure, and as at first after a success.
    pauses = [after - before for before, after in pairwise(output.opened_at)]
    assert pauses == pytest.approx([0.5, 1.0, 0.5], abs=0.1)
    statistics = fleet.statistics.outputs["fake"]
    assert statistics.failures == 3
    assert len(output.opened_at) == output.closed == 4
    assert statistics.dropped == 0
    assert len(output.accepted) == fleet.statistics.readings
    warned = [record for record in caplog.records if record.levelname == "WARNING"]
    messages = [record.getMessage() for record in warned]
    assert messages.count("fake: no") == 1  # each trouble once
    assert "fake: a bug" in messages
    assert messages.count("fake accepts readings again") == 2


@pytest.mark.parametrize("error", [OutputError("gone"), SystemError("?"), GeneratorExit()])
@in_simulated_time
async def test_only_a_permanent_error_ends_the_fleet(error: BaseException) -> None:
    """OutputError and what is not an Exception end `run`; the rest are tried again."""
    async with Peer() as peer:
        fleet = Fleet([meter("a", peer.url)], outputs=[FakeOutput(next=[error])])
        if isinstance(error, SystemError):
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(fleet.run(), 1)
        else:
            with pytest.raises(type(error)):
                await fleet.run()


@in_simulated_time
async def test_an_iterator_that_is_not_read_loses_the_oldest_readings() -> None:
    async with Peer() as peer:
        fleet = Fleet([meter("a", peer.url, interval=0.02)])
        iterator = fleet.readings(buffer=10)
        forgotten = fleet.readings()
        del forgotten
        async with fleet:
            assert (await anext(iterator)).device == "a"
            await until(lambda: iterator.dropped > 20)
            first = await anext(iterator)
        rest = [first, *[reading async for reading in iterator]]
        assert len(rest) == 10
        assert len(fleet._receivers._iterated) == 1


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("path", ["/dev/full", "/nowhere/at/all", "/proc/version"])
async def test_a_file_that_cannot_be_written_does_not_delay_other_outputs(path: str, caplog: Any):
    output = JsonOutput(path)
    fleet = await polled(output, lambda fleet: fleet.statistics.polls > 10, kind=real_peer)
    statistics = fleet.statistics.outputs[f"json {path}"]
    assert statistics.written == 0
    assert statistics.failures >= 1
    assert path in statistics.trouble
    assert caplog.text.count(f"json {path}: ") == 1


@pytest.mark.usefixtures("quick")
async def test_a_pipe_without_a_reader_does_not_delay_other_outputs(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    threads = threading.active_count()
    output = JsonOutput(str(path), buffer=100)
    try:
        async with real_peer() as peer:
            devices = [meter(f"{at}", peer.url, unit=at, interval=0.02) for at in range(1, 21)]
            async with Fleet(devices, outputs=[output]) as fleet:
                await until(lambda: fleet.statistics.outputs[output.name].dropped > 100)
                before = fleet.statistics.polls
                await until(lambda: fleet.statistics.polls > before + 20)
        assert fleet.statistics.failures == 0
    finally:
        with suppress(BlockingIOError):
            while os.read(reader, 1 << 16):
                pass
        os.close(reader)
    await until(lambda: threading.active_count() <= threads)


class Described(FakeOutput):
    """An output that wants to know the devices."""

    def describe_devices(self, devices: Any) -> None:
        self.labels = {name: device.labels for name, device in devices.items()}


@in_simulated_time
async def test_outputs_get_the_labels_of_devices_which_distinguish_equal_names():
    outputs = [Described(), FakeOutput(), FakeOutput()]
    async with Peer() as peer:
        devices = [meter("a", peer.url, labels={"site": "here"})]
        async with Fleet(devices, outputs=outputs) as fleet:
            assert outputs[0].labels == {"a": {"site": "here"}}
            assert list(fleet.statistics.outputs) == ["fake", "fake (2)", "fake (3)"]
            fleet.replace([meter("b", peer.url, labels={"site": "there"})])
            assert outputs[0].labels == {"b": {"site": "there"}}


def test_only_standard_output_gets_no_earlier_readings() -> None:
    assert JsonOutput("-").is_live is True
    assert JsonOutput("readings.json").is_live is False
