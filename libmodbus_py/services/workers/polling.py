"""
Runs a worker: carries out the decisions of `worker` with a clock, a bucket and a fleet.
"""

from __future__ import annotations

import asyncio
import math
import os
import re
import secrets
import socket
from collections.abc import Callable, Collection, Sequence
from typing import TYPE_CHECKING, Any

from ...protocol.logs import HarmlessLogger
from ...system import boot_time
from ..engine.buckets import Bucket, Change, Watch
from ..engine.errors import EngineError, what
from ..fleet.config import DeviceConfig, checked, devices_from_json
from ..fleet.fleet import Fleet
from ..fleet.journal.journal import Journal
from ..fleet.outputs.output import Output
from ..tasks import end_tasks
from .commands import CommandService
from .lease import OWN_PART
from .locations import Locations
from .records import Connection, FleetSettings
from .stream import Stream
from .unserved import Unserved
from .view import Entry
from .worker import Put, Worker

if TYPE_CHECKING:
    from nats.aio.client import Client

__all__ = ["BUCKET", "Polling", "clock"]

logger: HarmlessLogger = HarmlessLogger(__name__)

BUCKET = "modbus-fleet"

# The precision of timers: a fraction of a lease, but at most so many seconds.
EXACTNESS, COARSEST = 0.01, 0.1

# No timer is set for more seconds than this.
LONGEST_PAUSE = 60.0

# The most writes that may be pending; the worker repeats those that are left out.
MOST_WRITES = 512

# Seconds before the bucket is watched again.
PAUSE = 0.25

# Seconds within which the whole bucket must arrive, and a leaving worker must announce its end.
TIMEOUT = 3.0

# Seconds before the same line is logged again.
SAID_AGAIN = 60.0


clock = boot_time
"""The clock for leases, which also advances while the machine is suspended."""


class Polling:
    """
    Polls the devices that are assigned to this worker.

    Args:
        client: a connection to NATS. Call `engine_changed` when its state changes.
        bucket: the bucket of the fleet.
        settings: the current settings of the fleet.
        name: the name of this worker; empty for the name of the machine.
        zones: zones whose devices this worker polls, besides devices without a zone.
        outputs: outputs that get all readings, besides the stream of NATS.
        journal: keeps the readings on the disk of this machine; None for no journal.
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
        journal: Journal | None = None,
        clock: Callable[[], float] = clock,
    ) -> None:
        self.now: Callable[[], float] = clock
        self._client = client
        self._bucket = bucket
        self._name = re.sub(r"[^A-Za-z0-9_-]", "-", name or socket.gethostname())[:60]
        self.worker: Worker = Worker(self._new_id, {"", *zones})
        results = Stream(client, settings.results)
        self.fleet: Fleet = Fleet(
            outputs=[results, *outputs], journal=journal, may_ask=self._may_ask
        )
        self.fleet.commands.refusal = self._refusal
        self._service = CommandService(client, self.fleet.commands)
        self._takes_commands = settings.commands
        self._switched = asyncio.Event()
        # Set when a step is due before the planned time.
        self._woken = asyncio.Event()
        self._planned = math.inf
        # Set when the watch may have to be replaced.
        self._doubted = asyncio.Event()
        self._closed = asyncio.Event()
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
        self._unserved = Unserved(self.worker)

    def _new_id(self) -> str:
        return f"{self._name}.{secrets.token_hex(4)}"

    def _may_ask(self, connection: str) -> bool:
        return self.worker.may_ask(connection, self.now())

    # --- life -------------------------------------------------------------------------------

    async def run(self) -> None:
        """
        Poll until this worker has left: `leave` was called, and the end of the worker was seen in
        the bucket or three seconds have passed.

        Raises:
            EngineError: the connection to NATS was closed for good.
            JournalError: the journal cannot be used.
            OutputError: an output failed and cannot be opened again.
        """
        tasks = [
            asyncio.create_task(each())
            for each in (
                self.fleet.run,
                self._keep_watching,
                self._keep_turning,
                self._keep_listening,
                self._until_closed,
            )
        ]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            if self._late is not None:
                self._late.cancel()
            await end_tasks([*tasks, *self._writes])
            await self._service.end()
        for task in tasks:
            if not task.cancelled():
                task.result()

    def leave(self) -> None:
        """Stop polling, announce it to the other workers, and end within three seconds."""
        self.worker.leave()
        self._woken.set()
        self._late = asyncio.get_running_loop().call_later(TIMEOUT, self._end)

    async def _until_closed(self) -> None:
        await self._closed.wait()
        raise EngineError("the connection to NATS was closed; start the worker again")

    def _end(self) -> None:
        self._has_ended = True
        self._woken.set()

    def engine_changed(self) -> None:
        """Watch the bucket anew, because the connection was lost, established or closed."""
        if self._client.is_closed:
            self._closed.set()
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
        """Wait until a watch must be replaced, then end it."""
        timer = asyncio.get_running_loop().call_later(TIMEOUT, self._demand_all)
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

    def changed(self, entry: Entry) -> None:
        """Process a change of the bucket."""
        self.worker.saw(entry, self.now())
        self._follow_settings()
        self._look()

    def synced(self) -> None:
        """Process the end of the snapshot: the whole bucket has arrived."""
        self.worker.is_synced(self.now())
        self._follow_settings()
        self._look()

    def _follow_settings(self) -> None:
        settings = self.worker.view.settings
        if settings is not None and settings.commands != self._takes_commands:
            self._takes_commands = settings.commands
            if not settings.commands:
                self._service.stop()
            self._switched.set()

    async def _keep_listening(self) -> None:
        """Subscribe to commands while the fleet takes them."""
        while True:
            self._switched.clear()
            await self._service.end()
            try:
                if self._takes_commands:
                    await self._service.begin()
                await self._switched.wait()
            except Exception as error:
                self._say(f"commands: {what(error)}")
                await asyncio.sleep(PAUSE)

    def _look(self) -> None:
        """Wake `_keep_turning` if a step is due before the planned time."""
        if self.worker.due < self._planned:
            self._woken.set()

    async def _keep_turning(self) -> None:
        while not (self.worker.left or self._has_ended):
            now = self.now()
            puts = self.worker.step(now, self._report)
            # First, because other workers may poll a connection as soon as its slot is written.
            self._poll()
            for put in puts:
                self._write(put)
            self._tell_of_lease()
            for connection in self._unserved.found(now):
                self.fleet.report_offline(self._read(connection))
            if self.worker.is_blind(now):
                self._doubted.set()
            await self._until_due()

    async def _until_due(self) -> None:
        """Wait until a step of the worker is due."""
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
        """Set the devices of the fleet to those of the active connections."""
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
        self.fleet.replace(self._named_once(devices), passed_on=self._passed_on())

    def _passed_on(self) -> set[str]:
        """Return the connections that other workers can poll."""
        now, view, me = self.now(), self.worker.view, self.worker.lease.id
        zones = {
            zone
            for member in view.members.values()
            if member.id != me and self.worker.is_heard(member, now)
            for zone in member.zones
        }
        return {each.key for each in view.connections if each.zone in zones}

    def _named_once(self, devices: dict[str, list[DeviceConfig]]) -> list[DeviceConfig]:
        """Return the devices; of those with one name, only the first connection's are kept."""
        names: dict[str, str] = {}
        for key, group in devices.items():
            for each in group:
                if names.setdefault(each.name, key) != key:
                    self._say(
                        f"{key}: device {each.name!r} is not polled, because"
                        f" {names[each.name]} has a device of the same name"
                    )
        return [each for key, group in devices.items() for each in group if names[each.name] == key]

    def _read(self, connection: Connection) -> list[DeviceConfig]:
        try:
            devices = devices_from_json(connection.devices)
            if any(each.connection_key != connection.key for each in devices):
                raise ValueError("a device belongs to another connection")
            checked(devices)
        except Exception as error:
            # No record may stop a worker: others would take over the connection, and stop as well.
            self._say(f"{connection.key}: its devices in the bucket are invalid: {error}")
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
        """Return the refusal of a command, as `Commands` needs it."""
        if device in self.fleet.devices:
            return None
        return self._locations.refusal(device, self.now())

    # --- log ------------------------------------------------------------------------------------

    def _tell_of_lease(self) -> None:
        is_valid = self.now() < self.worker.lease.until
        if is_valid != self._was_valid and self.worker.lease.joined:
            self._was_valid = is_valid
            if is_valid:
                logger.warning("%s: the lease is valid again", self._name)
            else:
                logger.warning("%s: the lease has expired: NATS does not respond", self._name)
                self._take_back()
        for key, problem in self.worker.view.unreadable.items():
            self._say(f"the bucket: {problem or key}")

    def _take_back(self) -> None:
        """Report the devices as "offline", unless other workers may poll them already."""
        settings, lease = self.worker.view.settings, self.worker.lease
        if settings is None or settings.on_engine_loss == "continue":
            return
        if self.now() < lease.until + (1.0 - OWN_PART) * settings.lease:
            self.fleet.take_back()

    def _say(self, text: str) -> None:
        """Log a line, unless it was logged within the last minute."""
        now = self.now()
        if now > self._told.get(text, -SAID_AGAIN) + SAID_AGAIN:
            if len(self._told) > 100:
                self._told.clear()
            self._told[text] = now
            logger.warning("%s", text)


class _Told:
    """
    Passes the changes of a watch to a worker. The first change begins a snapshot.

    Args:
        polling: runs the worker.
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
            self._polling.changed(Entry(*change))
