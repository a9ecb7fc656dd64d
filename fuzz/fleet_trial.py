"""
Workers that share a fleet: python -m fuzz.fleet_trial [ROUNDS] [DEVICES] [LEASE]

Three workers of the command line, three servers of NATS, and DEVICES, 3000 unless told
otherwise, on servers of our own that note who asks them when. In each of ROUNDS, 20 unless
told otherwise, one worker is killed, one is stopped for longer than its lease and goes on, one
is cut off from NATS, one is told to end, and the leader among the servers of NATS is killed.
At the end all servers of NATS are gone for a minute.

Prints a table; exits with 1 if any device was asked by one worker while another had it.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

from fuzz.asked_devices import UNITS, Asked, Workers, asked_devices, fleet_file, until
from fuzz.command import numbers
from fuzz.nats_servers import NatsServers, Way
from libmodbus_py.services.engine.buckets import open_bucket
from libmodbus_py.services.engine.connection import EngineGone, open_connection
from libmodbus_py.services.workers.contents import fleet_status
from libmodbus_py.services.workers.records import BUCKET

INTERVAL = 2.0

PATIENCE = 120.0

# Seconds for which all NATS servers are stopped.
GONE = 60.0

NAMES = ("a", "b", "c")

# The worker whose connection to NATS can be cut.
CUT = "a"


class Trial:
    """
    All of it, and what it measures.

    Args:
        lease: seconds.
        devices: how many there are.
    """

    def __init__(
        self,
        servers: NatsServers,
        ways: list[Way],
        asked: Asked,
        workers: Workers,
        lease: float,
        devices: int,
    ) -> None:
        self.servers = servers
        self.ways = ways
        self.asked = asked
        self.workers = workers
        self.lease = lease
        self.devices = devices
        self.gaps: dict[str, list[float]] = {}
        self.takeovers: dict[str, list[float]] = {}
        self.doubles: dict[str, int] = {}

    def engine(self, name: str) -> str:
        if name == CUT:
            return ",".join(f"nats://127.0.0.1:{way.port}" for way in self.ways)
        return self.servers.urls

    def start(self, name: str) -> None:
        self.workers.start(name, self.engine(name))

    def settle(self) -> None:
        """Until three share the devices, and all are asked."""
        until(self._is_shared, PATIENCE)
        now = time.monotonic()
        until(lambda: self.asked.since(now) == self.devices, PATIENCE)

    def _is_shared(self) -> bool:
        try:
            status = asyncio.run(self._status())
        except EngineGone:  # a leader was killed, and the next one is not elected yet
            return False
        slots = [worker["slots"] for worker in status["workers"] if worker["state"] == "here"]
        return len(slots) == len(NAMES) and max(slots) - min(slots) <= 2

    async def _status(self) -> dict[str, Any]:
        client = await open_connection(self.servers.urls.split(","), name="trial")
        try:
            return await fleet_status(await open_bucket(client, BUCKET))
        finally:
            await client.close()

    def measure(self, name: str, fault: Callable[[Trial], Callable[[], object]]) -> None:
        """Cause one fault, wait until everything is over, and repair the fault."""
        self.settle()
        doubles = self.asked.doubles
        self.asked.forget()
        at = time.monotonic()
        mend = fault(self)
        # A place has ten units at different times: one of them is asked soon.
        until(lambda: self.asked.places_since(at) == self.devices // UNITS, PATIENCE)
        self.takeovers.setdefault(name, []).append(time.monotonic() - at)
        time.sleep(max(0, at + self.lease + 1.5 + INTERVAL - time.monotonic()))
        until(lambda: self.asked.silence < 2 * INTERVAL, PATIENCE)
        self.gaps.setdefault(name, []).append(self.asked.gap)
        mend()
        self.settle()
        found = self.asked.doubles - doubles
        self.doubles[name] = self.doubles.get(name, 0) + found

    def without_engine(self) -> str:
        """Stop NATS for a while; return what happened."""
        self.settle()
        doubles = self.asked.doubles
        at = time.monotonic()
        for number in range(len(self.servers.ports)):
            self.servers.kill(number)
        time.sleep(GONE)
        latest = self.asked.latest - at
        back = time.monotonic()
        for number in range(len(self.servers.ports)):
            self.servers.start(number)
        until(lambda: self.asked.since(back) == self.devices, PATIENCE)
        took = time.monotonic() - back
        self.settle()
        return (
            f"without NATS for {GONE:g} s: a device was asked the last time {latest:.1f} s after"
            f" NATS had gone; all were asked again {took:.1f} s after it came back;"
            f" {self.asked.doubles - doubles} double polls"
        )


def killed(trial: Trial) -> Callable[[], object]:
    trial.workers.kill("b")
    return lambda: trial.start("b")


def stopped(trial: Trial) -> Callable[[], object]:
    trial.workers.signal("c", signal.SIGSTOP)
    return lambda: trial.workers.signal("c", signal.SIGCONT)


def cut_off(trial: Trial) -> Callable[[], object]:
    for way in trial.ways:
        way.is_cut = True

    def mend() -> None:
        for way in trial.ways:
            way.is_cut = False

    return mend


def told_to_end(trial: Trial) -> Callable[[], object]:
    trial.workers.signal("b", signal.SIGTERM)
    trial.workers.ended("b")
    return lambda: trial.start("b")


def leader_killed(trial: Trial) -> Callable[[], object]:
    leader = trial.servers.leader(f"KV_{BUCKET}")
    trial.servers.kill(leader)
    return lambda: trial.servers.start(leader)


FAULTS = {
    "a worker is killed (kill -9)": killed,
    "stopped for longer than its lease, then continued": stopped,
    "cut off from NATS, then connected again": cut_off,
    "told to end (SIGTERM)": told_to_end,
    "the leader of the NATS servers is killed": leader_killed,
}


def table(trial: Trial) -> str:
    lines = [
        "| | rounds | all connections asked after: median | worst"
        " | longest gap of a device: median | worst | double polls |",
        "|---|--:|--:|--:|--:|--:|--:|",
    ]
    for name, gaps in trial.gaps.items():
        took = trial.takeovers[name]
        cells = [f"{entry:.1f} s" for entry in (median(took), max(took), median(gaps), max(gaps))]
        lines.append(f"| {name} | {len(gaps)} | {' | '.join(cells)} | {trial.doubles[name]} |")
    return "\n".join(lines)


def main() -> int:
    rounds, devices, lease = numbers(__doc__, rounds=20, devices=3000, lease=10)
    with contextlib.ExitStack() as stack:
        directory = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        # Otherwise a client that is cut off learns of ways that are not.
        servers = stack.enter_context(NatsServers(3, "--no_advertise"))
        ways = [stack.enter_context(Way(port)) for port in servers.ports]
        urls, asked = stack.enter_context(asked_devices(devices // UNITS))
        file = fleet_file(directory, urls, interval=INTERVAL, engine=f"lease = {lease}")
        workers = stack.enter_context(Workers(file, directory))
        trial = Trial(servers, ways, asked, workers, lease, devices // UNITS * UNITS)
        trial.start("b")
        until(lambda: asked.polls > 0, PATIENCE)
        trial.start("a")
        trial.start("c")
        trial.settle()
        for number in range(rounds):
            for name, fault in FAULTS.items():
                if sys.stderr.isatty():
                    text = f"\r\x1b[Kround {number + 1} of {rounds}: {name}"
                    print(text, end="", file=sys.stderr, flush=True)
                trial.measure(name, fault)
        without = trial.without_engine()
        if sys.stderr.isatty():
            print("\r\x1b[K", end="", file=sys.stderr)
        told = f"{devices} devices, each asked every {INTERVAL:g} s; a lease of {lease} s;"
        print(f"{told} {asked.polls} polls in all\n\n{table(trial)}\n\n{without}")
    return 1 if asked.doubles else 0


if __name__ == "__main__":
    sys.exit(main())
