"""
A fleet of two devices that writes to a file, while the n-th call of the system fails.
"""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path

import pytest

from libmodbus_py import Fleet, Point, RegisterMap
from libmodbus_py.services.fleet.outputs.line_file import JsonOutput
from libmodbus_py.services.fleet.poller import DeviceState
from tests.faults.injecting import Scenario, Trial, tried
from tests.faults.test_clients import each_echoed, on_line
from tests.services.fleet.fleets import meter, until
from tests.support.peers import FakeServer, FakeUnit

PART = ("services.fleet", "client", "ports")

ONE = RegisterMap([Point("value", "holding_registers", 5)])

INTERVAL = 0.01
TIMEOUT = 0.05


def polling(urls: list[str], file: Path) -> Scenario:
    """Poll until both were read and written, while calls fail and when they do not any more."""

    async def run(trial: Trial) -> None:
        devices = [
            meter(f"device {at}", url, map=ONE, interval=INTERVAL) for at, url in enumerate(urls)
        ]
        fleet = Fleet(devices, outputs=[JsonOutput(str(file))])
        with contextlib.ExitStack() as ends:
            ends.callback(file.unlink, missing_ok=True)
            async with contextlib.AsyncExitStack() as stack:
                with trial.faults():
                    await stack.enter_async_context(fleet)
                    await until(lambda: fleet.statistics.polls > 2 * len(urls))
                polls = fleet.statistics.polls + 2 * len(urls)
                (output,) = fleet.statistics.outputs.values()
                written = output.written
                await until(lambda: fleet.statistics.polls > polls and is_up(fleet))
                await until(lambda: output.written > written)
                with trial.faults():
                    await stack.aclose()

    return lambda trial: asyncio.run(run(trial))


def is_up(fleet: Fleet) -> bool:
    return all(each.state is DeviceState.UP for each in fleet.devices.values())


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits long for the next attempt."""
    monkeypatch.setattr("libmodbus_py.services.tasks.FIRST_PAUSE_S", 0.001)


def test_a_fleet_on_networks_and_lines(tmp_path: Path) -> None:
    with FakeServer(each_echoed) as server, FakeUnit(on_line) as unit:
        urls = [
            f"{server.url}?timeout={TIMEOUT}&max_pause=0",
            f"rtu://{unit.path}?baudrate=115200&timeout={TIMEOUT}&max_pause=0",
        ]
        tried(polling(urls, tmp_path / "readings.jsonl"), *PART)
