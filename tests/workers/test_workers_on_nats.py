"""
Workers of the real command line on a real nats-server: none of 300 devices is asked by two, and
gaps are as promised, whoever dies.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fuzz.asked_devices import Asked, Workers, asked_devices, fleet_file, until
from fuzz.nats_servers import NatsServers, Way
from libmodbus_py.cli.main import main
from libmodbus_py.engine.buckets import open_bucket
from libmodbus_py.engine.connection import connected
from libmodbus_py.workers.polling import BUCKET
from libmodbus_py.workers.status import fleet_status
from tests.workers.doubled import none_doubled

pytest.importorskip("nats")

pytestmark = pytest.mark.alone

LEASE = 1.5
INTERVAL = 0.4

# What a busy machine may take longer; no promise hangs on it.
SLACK = 10.0

CONNECTIONS = 30
DEVICES = 300


def command(*arguments: str, code: int = 0) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "libmodbus_py", *arguments],
        capture_output=True,
        text=True,
        timeout=40,
    )
    assert done.returncode == code, done.stderr
    return done.stdout + done.stderr


class Trial:
    """Three workers, one of which has a way of its own to the engine."""

    def __init__(self, servers: NatsServers, way: Way, asked: Asked, workers: Workers) -> None:
        self.servers = servers
        self.way = way
        self.asked = asked
        self.workers = workers

    def all_asked(self, patience: float) -> float:
        """Wait until all are, from now on; gives how long that took."""
        now = time.monotonic()
        return until(lambda: self.asked.since(now) == DEVICES, patience)

    def settle(self) -> None:
        """Until three share the devices."""
        until(lambda: len(self.shares()) == 3 and min(self.shares()) > 5, 30)
        self.all_asked(LEASE + SLACK)
        self.asked.forget()

    def shares(self) -> list[int]:
        status = asyncio.run(self._status())
        return [each["slots"] for each in status["workers"] if each["state"] == "here"]

    async def _status(self) -> dict[str, Any]:
        client = await connected(self.servers.urls.split(","), name="test")
        try:
            return await fleet_status(await open_bucket(client, BUCKET))
        finally:
            await client.close()


@contextlib.contextmanager
def three_workers(directory: Path, count: int, lease: float) -> Iterator[Trial]:
    with (
        NatsServers(count) as servers,
        Way(servers.ports[0]) as way,
        asked_devices(CONNECTIONS) as (urls, asked),
    ):
        file = fleet_file(directory, urls, interval=INTERVAL, engine=f"lease = {lease}")
        with Workers(file, directory) as workers:
            trial = Trial(servers, way, asked, workers)
            workers.start("a", f"nats://127.0.0.1:{way.port}")
            # The others find its fleet there. Three servers may elect for long.
            until(lambda: asked.polls > 0, 90)
            workers.start("b", servers.urls)
            workers.start("c", servers.urls)
            try:
                trial.settle()
                yield trial
            finally:
                none_doubled(asked)


@pytest.mark.timeout(400)
def test_whoever_dies_stops_or_leaves_none_is_asked_by_two(tmp_path):
    with three_workers(tmp_path, 1, LEASE) as trial:
        workers, asked = trial.workers, trial.asked

        workers.kill("b")
        assert trial.all_asked(LEASE + 1.5 + SLACK) < LEASE + 1.5 + SLACK

        workers.start("b", trial.servers.urls)
        trial.settle()
        workers.signal("b", signal.SIGTERM)
        assert trial.all_asked(1 + SLACK) < 1 + SLACK
        assert workers.ended("b") == 0
        # Nobody waited for a lease.
        assert asked.gap < LEASE + 2 * INTERVAL

        workers.start("b", trial.servers.urls)
        trial.settle()
        workers.signal("b", signal.SIGSTOP)
        trial.all_asked(LEASE + 1.5 + SLACK)
        workers.signal("b", signal.SIGCONT)
        trial.settle()
        none_doubled(asked)

        trial.way.is_cut = True
        time.sleep(LEASE + 1)
        trial.all_asked(LEASE + SLACK)
        trial.way.is_cut = False
        trial.settle()
        none_doubled(asked)

        trial.servers.kill()
        until(lambda: asked.since(time.monotonic() - 2 * INTERVAL) == 0, LEASE + SLACK)
        trial.servers.start(0)
        trial.all_asked(LEASE + SLACK + 10)


@pytest.mark.timeout(400)
def test_a_cluster_loses_its_leader_and_then_most_of_its_servers(tmp_path):
    lease = 6.0  # an election takes seconds
    with three_workers(tmp_path, 3, lease) as trial:
        servers, asked = trial.servers, trial.asked
        leader = servers.leader("KV_modbus-fleet")
        servers.kill(leader)
        trial.all_asked(lease + SLACK)
        time.sleep(lease)
        servers.kill((leader + 1) % 3)
        until(lambda: asked.since(time.monotonic() - 2 * INTERVAL) == 0, lease + SLACK)
        servers.start(leader)
        trial.all_asked(30)


@pytest.mark.timeout(400)
def test_push_gives_up_where_no_leader_is_elected(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("libmodbus_py.cli.workers.ELECTION", 0.5)
    with NatsServers(3) as servers:
        for number in (1, 2):
            servers.kill(number)
        file = fleet_file(tmp_path, ["tcp://127.0.0.1:9"], interval=1, engine="")
        assert main(["poll", str(file), "--engine", servers.urls, "--push"]) == 1
        told = capsys.readouterr().err.splitlines()[-1]
        assert told.startswith("libmodbus-py: modbus-fleet: ")
        assert "are most of its servers up?" in told


@pytest.mark.timeout(400)
def test_a_worker_waits_for_an_engine_whose_servers_are_still_starting(tmp_path):
    with NatsServers(3) as servers, asked_devices(1) as (urls, asked):
        for number in (1, 2):
            servers.kill(number)
        file = fleet_file(tmp_path, urls, interval=INTERVAL, engine=f"lease = {LEASE}")
        with Workers(file, tmp_path) as workers:
            waiting = workers.start("a", servers.urls)
            workers.start("b", servers.urls)
            until(lambda: "waiting for the engine" in workers.said("a"), 30)
            assert "no leader" in workers.said("a") or "no answer" in workers.said("a")
            time.sleep(LEASE)
            assert waiting.poll() is None
            workers.signal("a", signal.SIGINT)
            assert workers.ended("a") == 130
            assert "Traceback" not in workers.said("a")
            servers.start(1)
            # With two of three there is a leader, but no place for three copies.
            until(lambda: "too few of its servers are up" in workers.said("b"), 60)
            assert asked.polls == 0
            servers.start(2)
            until(lambda: asked.polls > 0, 60)
            told = workers.said("b").splitlines()
            assert len(told) == len(set(told))
            none_doubled(asked)
