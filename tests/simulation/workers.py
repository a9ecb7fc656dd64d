"""
Workers in a simulated world: each is a whole `Polling` with its fleet and its connection to the
engine, which leaves, is killed, or is stopped for a while.
"""

import asyncio
from collections.abc import Collection, Iterable, Sequence
from typing import Any, cast

from libmodbus_py.services.engine.buckets import open_bucket
from libmodbus_py.services.fleet.config import DeviceConfig
from libmodbus_py.services.fleet.outputs.output import Output
from libmodbus_py.services.workers.contents import PushCounts, connections_of, push, read_fleet
from libmodbus_py.services.workers.polling import Polling
from libmodbus_py.services.workers.records import FleetSettings

from .engine import Engine
from .network import Network
from .processes import Process


async def push_fleet(
    engine: Engine, devices: Iterable[DeviceConfig], settings: FleetSettings | None = None
) -> PushCounts:
    """Write the devices to the bucket, as ``poll --push`` does."""
    settings = settings or FleetSettings()
    client = engine.client()
    try:
        return await push(engine.bucket(client), settings, connections_of(devices, settings.lease))
    finally:
        await client.close()


class _SeededPolling(Polling):
    """A `Polling` whose ids the seed decides."""

    network: Network

    def _new_id(self) -> str:
        return f"{self._name}.{self.network.events.random.getrandbits(32):08x}"


class SimulatedWorker:
    """A worker."""

    polling: Polling

    def __init__(
        self,
        network: Network,
        engine: Engine,
        name: str,
        *,
        zones: Collection[str] = (),
        outputs: Sequence[Output] = (),
        rate: float = 1.0,
    ) -> None:
        self.process = Process(f"10.255.1.{next(engine.processes)}")
        self.client = self.process.call(engine.client)
        self._network = network
        self._name = name
        self._zones = zones
        self._outputs = outputs
        self._rate = rate
        self._offset = network.events.random.uniform(0, 1e6)

    async def start(self) -> None:
        """Read the settings of the fleet, and begin to poll."""
        await self.process.begin(self._start())
        self._task = self.process.begin(self.polling.run())

    async def _start(self) -> None:
        bucket = await open_bucket(cast(Any, self.client), "modbus-fleet")
        _, settings = await read_fleet(bucket)
        kind = type("_Polling", (_SeededPolling,), {"network": self._network})
        self.polling = kind(
            self.client,
            bucket,
            settings,
            name=self._name,
            zones=self._zones,
            outputs=self._outputs,
            clock=self.now,
        )
        self.client.on_change = self.polling.engine_changed

    def now(self) -> float:
        """Return the time of its own clock."""
        return self._offset + self._rate * self._network.events.now

    async def leave(self) -> None:
        """End as on SIGTERM: the other workers are informed."""
        self.process.call(self.polling.leave)
        await self._task
        await self.client.close()

    def kill(self) -> None:
        """End as on SIGKILL: nothing more is said to the engine or to devices; see `ended`."""
        self.process.is_stopped = False
        self.client.drop()
        self._task.cancel()

    async def ended(self) -> None:
        """Wait until the killed worker has left no task."""
        await asyncio.gather(self._task, return_exceptions=True)
        await self.client.close()
