"""Scenarios with fleets: workers share devices through an engine, and something happens to them."""

import asyncio
import itertools
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from libmodbus_py import Gateway, Route
from libmodbus_py.services.workers.records import FleetSettings
from tests.services.workers.trial import LEASE, Trial

from .world import World, asking_gateway

# Of the workers of a plant; seconds.
LONG_LEASE = 30.0

# Within how many leases all devices must be asked again after the last fault: by who is there, or
# by whoever takes over, at its next poll.
RECOVERY = 15.0

# The plant: so many units behind its gateway, and so many places with devices of the fleet.
BEHIND_GATEWAY, PLACES, UNITS = 20, 10, 10


class Fleet:
    """A `Trial` whose workers come and go, and whose engine fails."""

    def __init__(
        self, world: World, places: int, units: int, interval: float, lease: float = LEASE
    ) -> None:
        self._world = world
        self._lease = lease
        self._trial = Trial(
            places,
            settings=FleetSettings(lease),
            network=world.network,
            units=units,
            interval=interval,
        )
        self._names = (f"w{number}" for number in itertools.count(1))

    @asynccontextmanager
    async def polling(self, workers: int) -> AsyncIterator[None]:
        """Let so many workers poll."""
        async with self._trial.served():
            for _ in range(workers):
                await self._start()
            yield

    async def _start(self) -> None:
        await self._trial.start(next(self._names), rate=self._world.random.uniform(0.97, 1.03))

    async def disturb(self) -> None:
        """Let something happen to a worker or to the engine, and wait a while."""
        random, engine = self._world.random, self._trial.engine
        name = random.choice(list(self._trial.workers))
        worker = self._trial.workers[name]
        what = random.choice(["kill", "stop", "cut", "break", "lose", "restart"])
        pause = random.uniform(0.1, 3 * self._lease)
        if what == "kill":
            self._trial.kill(name)
            await self._start()
        elif what == "stop":
            worker.process.stop()
        elif what == "cut":
            worker.client.link.cut()
        elif what == "break":
            worker.client.link.break_off()
        elif what == "lose":
            engine.losses = random.choice([0.1, 0.5])
        else:
            engine.stop()
        await asyncio.sleep(pause)
        engine.losses = 0.0
        engine.start()
        if what == "stop":
            worker.process.go_on()
        elif what == "cut":
            worker.client.link.mend()

    def look(self) -> None:
        """No device is asked by two."""
        if self._trial.asked.doubles:
            url, at, peer = self._trial.asked.doubles[0]
            self._world.checker.fail("no device is asked by two", f"{url} by {peer} at {at:.3f}")

    async def recover(self) -> None:
        """Everything is there again: each device must be asked."""
        now, count = self._world.events.now, self._trial.count
        patience = RECOVERY * self._lease + self._trial.interval
        while self._trial.asked.since(now) < count:
            if self._world.events.now > now + patience:
                missing = count - self._trial.asked.since(now)
                text = f"{missing} of {count} devices are not asked"
                self._world.checker.fail("everybody is served when the faults are over", text)
                return
            await asyncio.sleep(0.5)


async def fleet(world: World) -> None:
    """Three workers that are killed, stopped and cut off, and an engine that loses and restarts."""
    until = world.events.now + world.options.seconds
    fleet_ = Fleet(world, places=world.options.units, units=2, interval=0.5)
    async with fleet_.polling(3):
        while world.events.now < until:
            await fleet_.disturb()
            fleet_.look()
            await asyncio.sleep(world.random.uniform(0, 2 * LEASE))
        await fleet_.recover()
        fleet_.look()


async def plant(world: World) -> None:
    """Four clients, a gateway with twenty units, a hundred devices and three workers."""
    half, timeout = BEHIND_GATEWAY // 2, 0.5
    world.bus("/dev/line", range(1, 1 + half), timeout, 19_200)
    numbers = range(1, 1 + BEHIND_GATEWAY)
    behind = world.host("tcp://10.0.0.1", range(1 + half, numbers.stop), timeout)
    routes = [
        Route(f"rtu:///dev/line?baudrate=19200&timeout={timeout}", range(1, 1 + half)),
        Route(f"{behind}?timeout={timeout}", range(1 + half, numbers.stop)),
    ]
    fleet_ = Fleet(world, PLACES, UNITS, interval=60.0, lease=LONG_LEASE)
    until = world.events.now + world.options.seconds
    gateway = Gateway(routes)
    count = world.options.clients
    async with asking_gateway(world, gateway, count, 3.0) as asks, fleet_.polling(3):
        acts = (world.act(ask, numbers, until) for ask in asks)
        await asyncio.gather(*acts, _disturb_until(world, fleet_, until))
        await fleet_.recover()
        fleet_.look()


async def _disturb_until(world: World, fleet_: Fleet, until: float) -> None:
    while world.events.now < until:
        await asyncio.sleep(world.random.expovariate(1 / 300.0))
        await fleet_.disturb()
        fleet_.look()
        world.checker.forget(world.events.now - 300.0)
