"""
What may happen to a worker that runs: a slow engine, another of its name, a bucket that is
deleted, and a stall in the middle of a burst.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import time

import pytest

from fuzz.asked_devices import UNITS, Workers, asked_devices, fleet_file, until
from fuzz.nats_servers import NatsServers, Way
from tests.workers.doubled import none_doubled

nats = pytest.importorskip("nats")

CONNECTIONS = 6
DEVICES = CONNECTIONS * UNITS


@pytest.mark.alone
@pytest.mark.timeout(300)
def test_workers_of_one_name_on_a_slow_engine_that_loses_its_bucket(tmp_path):
    with (
        NatsServers() as server,
        Way(server.ports[0]) as way,
        asked_devices(CONNECTIONS) as (urls, asked),
    ):
        file = fleet_file(tmp_path, urls, interval=0.1, engine="lease = 2")
        slow = f"nats://127.0.0.1:{way.port}"

        def all_asked(patience: float = 20) -> float:
            now = time.monotonic()
            return until(lambda: asked.since(now) == DEVICES, patience)

        with Workers(file, tmp_path) as workers, Workers(file, tmp_path) as others:
            workers.start("a", slow)
            until(lambda: asked.polls > 0, 30)
            others.start("a", server.urls)
            until(lambda: len(set(asked.peers.values())) >= CONNECTIONS, 20)
            all_asked()

            # Half a second each way; a worker may lose its lease, and no device is lost.
            way.delay = 0.5
            time.sleep(3)
            all_asked()
            way.delay = 0.0
            none_doubled(asked)

            # Stalls in the middle of bursts, shorter and longer than the lease.
            for seconds in (0.5, 3.0):
                workers.signal("a", signal.SIGSTOP)
                time.sleep(seconds)
                workers.signal("a", signal.SIGCONT)
                all_asked()
            none_doubled(asked)

            # All that workers rest on is gone; what is put there again is polled again.
            asyncio.run(_delete_bucket(server.urls))
            until(lambda: asked.since(time.monotonic() - 0.5) == 0, 10)
            assert "is gone" in workers.said("a")
            workers.start("p", server.urls, "--push")
            assert workers.ended("p") == 0
            all_asked(30)
            none_doubled(asked)


async def _delete_bucket(url: str) -> None:
    client = await nats.connect(url)
    with contextlib.suppress(Exception):
        await client.jetstream().delete_key_value("modbus-fleet")
    await client.close()
