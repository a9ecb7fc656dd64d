"""A fleet on a simulated network: devices that note who asks them, an engine, and whole workers."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from typing import Any

from libmodbus_py import Device, Mapping, Point, RegisterMap, Server
from libmodbus_py.fleet import DeviceConfig, Reading
from libmodbus_py.ports.trace import TracedFrame
from libmodbus_py.services.fleet.outputs.output import Output
from libmodbus_py.services.workers.records import FleetSettings
from tests.simulation.engine import Engine
from tests.simulation.network import Network
from tests.simulation.runner import runner_of
from tests.simulation.workers import SimulatedWorker, push_fleet

LEASE = 2.0
INTERVAL = 0.5
UNITS = 2  # behind each connection

MAP = RegisterMap(
    [
        Point("level", "holding_registers", 0),
        Point("setpoint", "holding_registers", 1, minimum=10, maximum=30),
    ]
)


class PollLog:
    """
    Who asked which device when. A worker has one connection to a place, and another one when it
    gets that place again; unless the engine forgot that it ever lost it, and then its lease was
    over meanwhile. So two have a device if one asks it over a connection, after somebody else did
    so within a lease. `doubles`: of each device that two had, when and by whom it was asked; `gap`:
    the longest time, in seconds, in which a device was not asked, since `forget`; `last`: when each
    device was asked the last time, and from where.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self.doubles: list[tuple[str, float, str]] = []
        self.gap: float = 0.0
        self.last: dict[tuple[str, int], tuple[float, str]] = {}
        self._now = now
        self._followed: dict[tuple[str, int], set[str]] = {}

    def note(self, event: TracedFrame) -> None:
        if event.direction != "received":
            return
        now, device, asking = self._now(), (event.endpoint, event.unit or 0), event.peer or ""
        before, peer = self.last.get(device, (now, asking))
        self.gap = max(self.gap, now - before)
        followed = self._followed.setdefault(device, set())
        if peer != asking:
            followed.add(peer)
        if asking in followed and peer != asking and now - before < LEASE:
            self.doubles.append((device[0], now, asking))
        self.last[device] = now, asking

    def forget(self) -> None:
        self.gap = 0.0

    def since(self, at: float) -> int:
        """Return how many devices were asked since a time."""
        return sum(last >= at for last, _ in self.last.values())

    @property
    def latest(self) -> float:
        """When any device was asked the last time."""
        return max(last for last, _ in self.last.values())

    def hosts(self) -> dict[str, int]:
        """Return how many devices each worker asked last, by its host."""
        counts: dict[str, int] = {}
        for _, peer in self.last.values():
            host = peer.rpartition(":")[0]
            counts[host] = counts.get(host, 0) + 1
        return counts


class _Told(Output):
    """An output as those of a broker: it keeps what each worker reports, and when."""

    name = "told"

    def __init__(self, trial: Trial, worker: str) -> None:
        self._trial = trial
        self._worker = worker

    async def write_readings(self, readings: Sequence[Reading]) -> None:
        self._trial.told += [(self._trial.now, self._worker, reading) for reading in readings]


class Trial:
    """
    All of it: so many connections with some units each, and the workers that were started. `told`:
    what was reported of each device: when, by which worker, and the reading.
    """

    def __init__(
        self,
        connections: int,
        *,
        settings: FleetSettings | None = None,
        seed: int = 1,
        network: Network | None = None,
        units: int = UNITS,
        interval: float = INTERVAL,
    ) -> None:
        self.network = network or Network(seed)
        self.engine = Engine(self.network)
        self.asked = PollLog(lambda: self.now)
        self.settings = settings or FleetSettings(LEASE)
        self.places = [f"tcp://10.0.2.{at + 1}:502" for at in range(connections)]
        self.units, self.interval = units, interval
        self.workers: dict[str, SimulatedWorker] = {}
        self.told: list[tuple[float, str, Reading]] = []
        self._killed: list[SimulatedWorker] = []
        self.levels = Mapping(holding_registers=2)

    @property
    def now(self) -> float:
        return self.network.events.now

    @property
    def count(self) -> int:
        """How many devices there are."""
        return len(self.places) * self.units

    def devices(self, places: int | None = None, zone: str = "") -> list[DeviceConfig]:
        return [
            DeviceConfig(
                name=f"d{at}-{unit}",
                url=url,
                unit=unit,
                map=MAP,
                interval=self.interval,
                timeout=0.2,
                zone=zone,
            )
            for at, url in enumerate(self.places[:places])
            for unit in range(1, self.units + 1)
        ]

    def run(self, main: Callable[[], Awaitable[None]]) -> None:
        """Run a test; no device may have been asked by two."""

        async def whole() -> None:
            async with self.served():
                await main()

        self.network.run(whole)
        assert not self.asked.doubles

    @asynccontextmanager
    async def served(self) -> AsyncIterator[None]:
        """Serve the devices, and kill all workers in the end."""
        units = {unit: Device(self.levels) for unit in range(1, self.units + 1)}
        async with Server(units, trace=self.asked.note).serving(*self.places):
            await push_fleet(self.engine, self.devices(), self.settings)
            try:
                yield
            finally:
                for name in list(self.workers):
                    self.kill(name)
                await asyncio.gather(*(entry.ended() for entry in self._killed))

    def kill(self, name: str) -> None:
        """Kill a worker, as SIGKILL does."""
        worker = self.workers.pop(name)
        worker.kill()
        self._killed.append(worker)

    async def start(
        self, *names: str, outputs: Sequence[Output] | None = None, **options: Any
    ) -> None:
        for name in names:
            own = outputs or [_Told(self, name)]
            worker = SimulatedWorker(self.network, self.engine, name, outputs=own, **options)
            self.workers[name] = worker
            await worker.start()

    async def until(self, is_so: Callable[[], object], patience: float) -> float:
        """Wait for something; return how long that took, in simulated seconds."""
        since = self.now
        while not is_so():
            assert self.now < since + patience, "it does not come true"
            await asyncio.sleep(0.05)
        return self.now - since

    async def all_asked(self, patience: float) -> float:
        """Wait until all devices were, from now on; return how long that took."""
        now = self.now
        return await self.until(lambda: self.asked.since(now) == self.count, patience)

    async def settle(self) -> None:
        """Wait until the workers that are there share the devices, and measure anew."""
        await asyncio.sleep(1.5 * LEASE)
        await self.all_asked(LEASE + INTERVAL)
        self.asked.forget()

    def qualities(self) -> list[str]:
        """Return the qualities that the points of all devices were reported to have last."""
        last = {(reading.device, reading.name): reading.quality for _, _, reading in self.told}
        assert len(last) == 2 * self.count
        return sorted(set(last.values()))

    def offline(self) -> list[tuple[float, str, str]]:
        """Return when which worker reported which device as offline, a row for each point."""
        return [(at, by, item.device) for at, by, item in self.told if item.quality == "offline"]


def on_trial(connections: int, *workers: str, **options: Any) -> Callable[[Any], Any]:
    """
    Make a test of a coroutine that is given a `Trial` first; no device is asked by two. `workers`:
    the names of those that share the devices when the test begins.
    """

    def run(test: Callable[[Trial], Awaitable[None]]) -> None:
        trial = Trial(connections, **options)

        async def settled() -> None:
            if workers:
                await trial.start(*workers)
                await trial.settle()
            await test(trial)

        trial.run(settled)

    return runner_of(run)
