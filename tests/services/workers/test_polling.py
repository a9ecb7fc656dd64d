"""
A worker with its clock, its bucket and its fleet, on simulated time: how it begins, goes on and
ends, what it logs and reports.
"""

import asyncio
import inspect
import json
import logging
import re
import socket
import time
from typing import Any

import pytest

from libmodbus_py import Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.services.engine.connection import EngineError
from libmodbus_py.services.fleet.config import devices_to_json
from libmodbus_py.services.fleet.outputs.output import OutputError
from libmodbus_py.services.workers import polling
from libmodbus_py.services.workers.decisions import step
from libmodbus_py.services.workers.polling import REPORT_AGAIN_S, TIMEOUT_S, Polling
from libmodbus_py.services.workers.records import Connection
from libmodbus_py.services.workers.worker import Decision, Worker
from tests.services.workers.trial import INTERVAL, LEASE, UNITS, Trial, on_trial
from tests.simulation.engine import Engine

MAP = RegisterMap([Point("level", "holding_registers", 0)])


@pytest.fixture(autouse=True)
def _logged(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, logger="libmodbus_py.services.workers")


def record_of(trial: Trial) -> dict[str, Any]:
    """Return the record that the worker wrote last."""
    latest = trial.engine.latest or {}
    (value,) = [entry.value for key, entry in latest.items() if key.startswith("worker.")]
    record: dict[str, Any] = json.loads(value or b"")
    return record


@on_trial(2)
async def test_a_worker_waits_for_the_longest_lease_and_records_its_end(trial: Trial):
    await trial.start("a")
    took = await trial.all_asked(2 * LEASE)
    assert LEASE < took < LEASE + INTERVAL + 1
    await asyncio.sleep(5)
    record = record_of(trial)
    report = record["report"]
    assert record["state"] == "here"
    assert report.pop("polls") == pytest.approx(trial.count / INTERVAL, rel=0.2)
    assert report == {"connections": 2, "devices": 2 * UNITS, "up": 2 * UNITS, "down": 0}
    await trial.workers.pop("a").leave()
    assert record_of(trial)["state"] == "ended"


@on_trial(1, "a")
async def test_a_worker_ends_within_seconds_although_the_engine_is_gone(trial: Trial) -> None:
    trial.engine.stop()
    since = trial.now
    await trial.workers.pop("a").leave()
    assert trial.now - since == pytest.approx(TIMEOUT_S, abs=0.2)


@on_trial(1, "a")
async def test_a_closed_connection_or_the_end_of_an_output_ends_the_worker(
    trial: Trial, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker that cannot reach NATS any more must not look alive."""
    polling = trial.workers["a"].polling
    monkeypatch.setattr(trial.workers["a"].client, "is_closed", True)
    polling.engine_changed()
    with pytest.raises(EngineError, match="the connection to NATS was closed"):
        await trial.workers["a"]._task
    monkeypatch.undo()

    async def fail(self: object) -> None:
        raise OutputError("nobody reads")

    monkeypatch.setattr("libmodbus_py.services.fleet.fleet.Fleet.run", fail)
    await trial.start("b")
    with pytest.raises(OutputError, match="nobody reads"):
        await trial.workers["b"]._task


@on_trial(1)
async def test_the_name_of_a_worker_or_of_its_machine_becomes_a_key(trial: Trial) -> None:
    names = ["hall 2.north", "x" * 90, ""]
    await trial.start(*names)
    machine = re.sub(r"[^A-Za-z0-9_-]", "-", socket.gethostname())[:60]
    ids = [trial.workers[name].polling.worker.id.split(".")[0] for name in names]
    assert ids == ["hall-2-north", "x" * 60, machine]


def test_a_lease_goes_on_while_the_machine_sleeps() -> None:
    default = inspect.signature(Polling).parameters["clock"].default
    before = time.clock_gettime(time.CLOCK_BOOTTIME)
    assert before <= default() <= time.clock_gettime(time.CLOCK_BOOTTIME)


@on_trial(1, "a")
async def test_a_worker_watches_again_when_the_bucket_does_not_arrive_whole(
    trial: Trial, monkeypatch: pytest.MonkeyPatch
) -> None:
    polling = trial.workers["a"].polling
    with monkeypatch.context() as patched:
        # Only the first change of each watch arrives.
        tell = Engine._tell

        def tell_first(engine: Engine, consumer: Any, entry: Any) -> None:
            if not consumer.sequence:
                tell(engine, consumer, entry)
            consumer.sequence += 1
            consumer.position = entry.revision

        patched.setattr(Engine, "_tell", tell_first)
        polling.engine_changed()
        await trial.until(lambda: polling.worker.is_reading, LEASE)
        since = trial.now
    await trial.until(lambda: not polling.worker.is_reading, 2 * TIMEOUT_S)
    assert TIMEOUT_S - 0.5 < trial.now - since < TIMEOUT_S + 1
    await trial.all_asked(2 * LEASE)


@on_trial(1, "a")
async def test_a_single_worker_decides_as_often_as_it_renews_its_lease(trial: Trial, monkeypatch):
    decided: list[float] = []

    def counted(worker: Worker, at: float, report: Any) -> Decision:
        decided.append(at)
        return step(worker, at, report)

    monkeypatch.setattr(polling, "step", counted)
    revision = trial.engine.revision
    await asyncio.sleep(10 * LEASE)
    assert trial.engine.revision - revision == pytest.approx(100, abs=5)
    assert len(decided) <= 210  # and when its value is seen


@on_trial(1, "a")
async def test_a_lost_engine_is_logged_once_a_minute_and_each_change_of_the_lease(
    trial: Trial, caplog: pytest.LogCaptureFixture
) -> None:
    def told() -> list[str]:
        return [record.message for record in caplog.records if "workers" in record.name]

    trial.engine.stop()
    failure = "the engine: modbus-fleet: no server responds"
    expiry = "a: the lease has expired: NATS does not respond"
    await asyncio.sleep(REPORT_AGAIN_S - 15.0)
    assert sorted(told()) == [expiry, failure]
    await asyncio.sleep(25.0)
    assert told().count(failure) == 2
    trial.engine.start()
    await trial.settle()
    assert told()[-1] == "a: the lease is valid again"


@on_trial(1)
async def test_an_unreadable_record_is_logged_and_polled_by_no_worker(trial: Trial, caplog) -> None:
    def connection(host: int, *names: str, devices: str = "") -> Connection:
        devices_ = [DeviceConfig(name, f"tcp://10.0.1.{host}", MAP) for name in names]
        return Connection("", f"tcp:10.0.1.{host}:502", 0.5, devices or devices_to_json(devices_))

    bad = [
        connection(1, devices='{"devices": [{"name": "pump"}]}'),
        connection(2, devices=connection(1, "pump").devices),
    ]
    for key in (wrong := ("connection._.abc", "slot._.900", "worker.x.y")):
        trial.engine.write(key, b"[" * 5000)
    # Of two devices of one name, one is polled.
    for request in (*bad, connection(4, "valve", "fan"), connection(5, "fan")):
        trial.engine.write(request.bucket_key, request.encode())
    await trial.start("a")
    await trial.settle()
    assert sorted(trial.workers["a"].polling.fleet.devices) == ["d0-1", "d0-2", "fan", "valve"]
    messages = sorted(text[: text.find(": ", 12)] for text in caplog.messages)
    assert messages == sorted([f"the bucket: {key}" for key in wrong] + [item.key for item in bad])
