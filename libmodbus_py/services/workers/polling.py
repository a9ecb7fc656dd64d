"""
A worker with its clock, its bucket and its fleet: what `worker` decides is done here.
"""

from __future__ import annotations

import asyncio
import logging
import math
import os
import re
import secrets
import socket
import time
from collections.abc import Callable, Collection, Sequence
from typing import TYPE_CHECKING, Any

from ..engine.buckets import Bucket, Change, Watch
from ..engine.errors import EngineError
from ..fleet.commands import Commands
from ..fleet.config import DeviceConfig, devices_from_json
from ..fleet.fleet import Fleet
from ..fleet.outputs.output import Output
from ..fleet.outputs.stream import Stream
from .commands import CommandService
from .locations import Locations
from .records import Connection, FleetSettings
from .view import Entry
from .worker import Put, Worker

if TYPE_CHECKING:
    from nats.aio.client import Client

__all__ = ["BUCKET", "Polling", "clock"]

logger: logging.Logger = logging.getLogger(__name__)

BUCKET = "modbus-fleet"

# Of a lease, and in seconds: how exactly a worker looks at its clock when something is due.
EXACTNESS, COARSEST = 0.01, 0.1

# Seconds; no timer is set for longer.
LONGEST_PAUSE = 60.0

# Writes that are on their way; what is beyond them waits for the next turn.
MOST_WRITES = 512

# Seconds until a new try to watch.
PAUSE = 0.25

# Seconds for the bucket to be told whole; and to say that a worker has ended.
PATIENCE = 3.0

# Seconds between two lines about the same trouble.
SAID_AGAIN = 60.0


def clock() -> float:
    """Seconds that go on while the machine sleeps: a lease does so, too."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class Polling:
    """
    Polls the devices that fall to this worker.

    Args:
        client: connected; its changes must come to `engine_changed`.
        bucket: with the fleet.
        settings: of the fleet, as they are now.
        name: of this worker; the name of the machine unless given.
        zones: whose devices it takes, besides those without a zone.
        outputs: that are given all readings, besides the stream.
        clock: returns the time in seconds, for leases.
    """

    def __init__(
        self,
        client: Client,
        bucket: Bucket,
        settings: FleetSettings,
        *,
        name: str = "",
        zones: Collection[str] = (),
        outputs: Sequence[Output] = (),
        clock: Callable[[], float] = clock,
    ) -> None:
        self.now: Callable[[], float] = clock
        self._client = client
        self._bucket = bucket
        self._name = re.sub(r"[^A-Za-z0-9_-]", "-", name or socket.gethostname())[:60]
        self.worker: Worker = Worker(self._new_id, {"", *zones})
        results = Stream(client, settings.results)
        self.fleet: Fleet = Fleet(outputs=[results, *outputs], may_ask=self._may_ask)
        self._service: CommandService | None = None
        if settings.commands:
            self._service = CommandService(client, Commands(self.fleet), self._refusal)
        # Set when a turn is due before it was planned; and when the watch may be of no use.
        self._woken = asyncio.Event()
        self._planned = math.inf
        self._doubted = asyncio.Event()
        self._is_unsettled = False
        self._has_ended = False
        self._late: asyncio.TimerHandle | None = None
        self._active: dict[str, Connection] = {}
        self._connections: dict[str, Connection] = {}
        self._devices: dict[str, list[DeviceConfig]] = {}
        self._writes: set[asyncio.Task[None]] = set()
        self._told: dict[str, float] = {}
        self._was_valid = True
        self._polls = 0
        self._polls_at = self.now()
        self._rate = 0.0
        self._locations = Locations(self.worker)

    def _new_id(self) -> str:
        return f"{self._name}.{secrets.token_hex(4)}"

    def _may_ask(self, connection: str) -> bool:
        return self.worker.may_ask(connection, self.now())

    # --- life -------------------------------------------------------------------------------

    async def run(self) -> None:
        """
        Poll until `leave` was called, and the others know.

        Raises:
            OutputError: an output is gone for good.
        """
        polling = asyncio.create_task(self.fleet.run())
        watching = asyncio.create_task(self._keep_watching())
        turning = asyncio.create_task(self._keep_turning())
        tasks = (polling, watching, turning)
        try:
            if self._service is not None:
                await self._service.begin()
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            if self._late is not None:
                self._late.cancel()
            for task in (*tasks, *self._writes):
                task.cancel()
            await asyncio.gather(*tasks, *self._writes, return_exceptions=True)
            if self._service is not None:
                await self._service.end()
        for task in tasks:
            if not task.cancelled():
                task.result()

    def leave(self) -> None:
        """Ask nobody any more, tell the others, and end; within seconds, whatever they say."""
        self.worker.leave()
        self._woken.set()
        self._late = asyncio.get_running_loop().call_later(PATIENCE, self._end)

    def _end(self) -> None:
        self._has_ended = True
        self._woken.set()

    def engine_changed(self) -> None:
        """The connection to the engine was lost, or stands again: what was missed is unknown."""
        self._is_unsettled = True
        self._doubted.set()

    # --- the bucket ----------------------------------------------------------------------------

    async def _keep_watching(self) -> None:
        while True:
            self._is_unsettled = False
            try:
                watch = await self._bucket.watch(_Told(self), self._doubted.set)
                await self._until_useless(watch)
            except EngineError as error:
                self._say(f"the engine: {error}")
            await asyncio.sleep(PAUSE)

    async def _until_useless(self, watch: Watch) -> None:
        """Wait until a watch must be replaced, and end it."""
        timer = asyncio.get_running_loop().call_later(PATIENCE, self._demand_all)
        try:
            while not (watch.is_broken or self._is_unsettled or self.worker.is_blind(self.now())):
                self._doubted.clear()
                await self._doubted.wait()
        finally:
            timer.cancel()
            await watch.end()

    def _demand_all(self) -> None:
        if self.worker.is_reading:
            self.engine_changed()

    def heed(self, entry: Entry) -> None:
        """A change of the bucket."""
        self.worker.saw(entry, self.now())
        self._look()

    def synced(self) -> None:
        """All of the bucket was told."""
        self.worker.is_synced(self.now())
        self._look()

    def _look(self) -> None:
        """Wake the turns if one is due before it was planned."""
        if self.worker.due < self._planned:
            self._woken.set()

    async def _keep_turning(self) -> None:
        while not (self.worker.left or self._has_ended):
            now = self.now()
            puts = self.worker.step(now, self._report)
            # Before anything is written: others may ask as soon as that is.
            self._poll()
            for put in puts:
                self._write(put)
            self._tell_of_lease()
            if self.worker.is_blind(now):
                self._doubted.set()
            await self._until_due()

    async def _until_due(self) -> None:
        """Wait until the worker may have something to decide: once at least."""
        loop, settings = asyncio.get_running_loop(), self.worker.view.settings
        shortest = min(COARSEST, EXACTNESS * settings.lease if settings else COARSEST)
        while True:
            now = self.now()
            pause = min(LONGEST_PAUSE, max(shortest, self.worker.due - now))
            self._planned = now + pause
            timer = loop.call_later(pause, self._woken.set)
            try:
                await self._woken.wait()
            finally:
                timer.cancel()
            self._woken.clear()
            if self.worker.due <= self.now() or self._has_ended:
                return

    def _write(self, put: Put) -> None:
        if len(self._writes) < MOST_WRITES and self._client.is_connected:
            task = asyncio.create_task(self._written(put))
            self._writes.add(task)
            task.add_done_callback(self._writes.discard)

    async def _written(self, put: Put) -> None:
        try:
            revision = await self._bucket.put(put.key, put.value, put.last)
            if revision:
                self.worker.was_written(put, revision)
                self._look()
        except EngineError as error:
            self._say(f"the engine: {error}")

    # --- devices --------------------------------------------------------------------------------

    def _poll(self) -> None:
        """Have the fleet poll what is active."""
        active = self.worker.active
        if active is self._active:
            return
        self._active = active
        devices: dict[str, list[DeviceConfig]] = {}
        for key, connection in active.items():
            known = self._connections.get(key)
            if known == connection and key in self._devices:
                devices[key] = self._devices[key]
            else:
                devices[key] = self._read(connection)
        self._connections = dict(active)
        self._devices = devices
        try:
            self.fleet.replace([each for group in devices.values() for each in group])
        except (TypeError, ValueError) as error:
            self._say(f"the devices in the bucket cannot be polled together: {error}")
            self.fleet.replace([])

    def _read(self, connection: Connection) -> list[DeviceConfig]:
        try:
            devices = devices_from_json(connection.devices)
            if any(each.connection_key != connection.key for each in devices):
                raise ValueError("a device that is elsewhere")
        except (TypeError, ValueError) as error:
            self._say(f"{connection.key}: what the bucket has of it cannot be read: {error}")
            return []
        return devices

    def _report(self) -> dict[str, Any]:
        statistics, now = self.fleet.statistics, self.now()
        if now - self._polls_at >= 1.0:
            self._rate = (statistics.polls - self._polls) / (now - self._polls_at)
            self._polls, self._polls_at = statistics.polls, now
        outputs = {
            name: {"waiting": each.waiting, "dropped": each.dropped}
            for name, each in statistics.outputs.items()
        }
        return {
            "connections": len(self._connections),
            "devices": statistics.devices,
            "up": statistics.up,
            "down": statistics.down,
            "polls": round(self._rate, 1),
            "host": socket.gethostname(),
            "process": os.getpid(),
            "outputs": outputs,
        }

    def _refusal(self, device: str) -> str | None:
        """See `CommandService`."""
        if device in self.fleet.devices:
            return None
        return self._locations.refusal(device, self.now())

    # --- for people -----------------------------------------------------------------------------

    def _tell_of_lease(self) -> None:
        is_valid = self.now() < self.worker.lease.until
        if is_valid != self._was_valid and self.worker.lease.joined:
            self._was_valid = is_valid
            if is_valid:
                logger.warning("%s: the lease stands again", self._name)
            else:
                logger.warning("%s: the lease has ended: the engine is not heard", self._name)
        for key, problem in self.worker.view.unreadable.items():
            self._say(f"the bucket: {problem or key}")

    def _say(self, text: str) -> None:
        """Once a minute at most."""
        now = self.now()
        if now > self._told.get(text, -SAID_AGAIN) + SAID_AGAIN:
            if len(self._told) > 100:
                self._told.clear()
            self._told[text] = now
            logger.warning("%s", text)


class _Told:
    """
    What a watch tells goes to the worker; that begins when the first of it comes.

    Args:
        polling: whose worker it is.
    """

    def __init__(self, polling: Polling) -> None:
        self._polling = polling
        self._has_begun = False

    def __call__(self, change: Change | None) -> None:
        worker = self._polling.worker
        if not self._has_begun:
            self._has_begun = True
            worker.begins()
        if change is None:
            self._polling.synced()
        else:
            self._polling.heed(Entry(*change))
