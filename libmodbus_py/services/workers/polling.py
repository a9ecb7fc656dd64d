"""Runs a worker: carries out its decisions with a clock, a bucket and a fleet."""

from __future__ import annotations

import asyncio
import math
import re
import secrets
import socket
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ...protocol.logs import HarmlessLogger
from ...system import boot_time
from ..engine.buckets import Bucket, Change
from ..engine.connection import EngineError
from ..fleet.config import DeviceConfig
from ..fleet.fleet import Fleet
from ..fleet.journal.journal import Journal
from ..fleet.outputs.output import Output
from ..tasks import KeptTasks, end_tasks
from .contents import devices_of
from .decisions import step
from .messages import CommandService, Stream, refusal
from .records import Connection, FleetSettings
from .worker import OWN_PART, Put, Worker

if TYPE_CHECKING:
    from nats.aio.client import Client

logger: HarmlessLogger = HarmlessLogger(__name__)

# The precision of timers: a fraction of a lease, but at most so many seconds.
EXACTNESS, COARSEST_S = 0.01, 0.1

# Seconds before the bucket is watched again.
PAUSE_S = 0.25

# Seconds within which the whole bucket must arrive, and a leaving worker must announce its end.
TIMEOUT_S = 3.0

# Seconds before the same line is logged again, and the most lines that are remembered for this.
REPORT_AGAIN_S = 60.0
MOST_REPORTS = 100


class Polling:
    """
    Polls the devices that are assigned to this worker, whose name is that of the machine unless
    another is given. The clock of its leases also advances while the machine is suspended.
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
        clock: Callable[[], float] = boot_time,
    ) -> None:
        self.now: Callable[[], float] = clock
        self._client = client
        self._bucket = bucket
        self._name = re.sub(r"[^A-Za-z0-9_-]", "-", name or socket.gethostname())[:60]
        self.worker: Worker = Worker(self._new_id, {"", *zones})
        limits = {"max_age": settings.max_age, "max_bytes": settings.max_bytes}
        self.fleet: Fleet = Fleet(
            outputs=[Stream(client, limits), *outputs], journal=journal, may_ask=self._may_ask
        )
        self.fleet.commands.refusal = self._refusal
        self._service = CommandService(client, self.fleet.commands, self._log_problem)
        self._service.switch(settings.commands)
        # Set when a decision is needed.
        self._woken = asyncio.Event()
        self._leave_by = math.inf
        # Set if the bucket must be read again; whether a key, and whether all keys, have arrived.
        self._doubted = asyncio.Event()
        self._has_begun = self._is_whole = False
        self._active: Mapping[str, Connection] = {}
        self._devices: dict[str, list[DeviceConfig]] = {}
        # The keys of the connections that were reported "offline" because no worker polls them.
        self._unserved: set[str] = set()
        self._writes = KeptTasks()
        self._reports: dict[str, float] = {}
        self._was_valid = True
        # The number of polls at a time, and the rate up to then.
        self._polls: tuple[int, float] = 0, self.now()
        self._rate = 0.0

    def _new_id(self) -> str:
        return f"{self._name}.{secrets.token_hex(4)}"

    def _may_ask(self, connection: str) -> bool:
        return self.worker.may_ask(connection, self.now())

    # --- life -------------------------------------------------------------------------------

    async def run(self) -> None:
        """
        Poll until this worker has left: `leave` was called, and the end of the worker was seen in
        the bucket or three seconds have passed. An EngineError means that the connection to NATS
        was closed for good; errors of the journal and of outputs end it, too.
        """
        parts = self.fleet.run, self._keep_watching, self._keep_deciding, self._service.run
        tasks = [asyncio.create_task(part()) for part in parts]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            await end_tasks([*tasks, *self._writes])
        for task in tasks:
            if not task.cancelled():
                task.result()

    def leave(self) -> None:
        """Stop polling, announce it to the other workers, and end within three seconds."""
        self.worker.leave()
        self._leave_by = self.now() + TIMEOUT_S
        self._woken.set()

    def engine_changed(self) -> None:
        """Watch the bucket anew, because the connection was lost, established or closed."""
        self._doubted.set()

    # --- the bucket ----------------------------------------------------------------------------

    async def _keep_watching(self) -> None:
        while not self._client.is_closed:
            self._has_begun = self._is_whole = False
            self._doubted.clear()
            try:
                watch = await self._bucket.watch(self._receive, self._doubted.set)
                timer = asyncio.get_running_loop().call_later(TIMEOUT_S, self._demand_whole)
                try:
                    await self._doubted.wait()
                finally:
                    timer.cancel()
                    await watch.end()
            except EngineError as error:
                self._log_problem(f"the engine: {error}")
            await asyncio.sleep(PAUSE_S)
        raise EngineError("the connection to NATS was closed; start the worker again")

    def _demand_whole(self) -> None:
        if not self._is_whole:
            self._doubted.set()

    def _receive(self, change: Change | None) -> None:
        """Take a change: the first one of a watch begins a snapshot, None ends it."""
        if not self._has_begun:
            self._has_begun = True
            self.worker.begin_snapshot()
        if change is None:
            self._is_whole = True
            self.worker.end_snapshot(self.now())
        else:
            self.worker.add_change(change, self.now())
        if self.worker.view.settings is not None:
            self._service.switch(self.worker.view.settings.commands)
        self._woken.set()

    async def _write(self, put: Put) -> None:
        try:
            await self._bucket.put(*put)
        except EngineError as error:
            self._log_problem(f"the engine: {error}")

    # --- decisions ------------------------------------------------------------------------------

    async def _keep_deciding(self) -> None:
        now = self.now()
        while not self.worker.has_left and now < self._leave_by:
            decision = step(self.worker, now, self._report())
            # First, because other workers may poll a connection as soon as its slot is written.
            self._poll(decision.active)
            for put in decision.puts:
                self._writes.begin(self._write(put))
            self._log_lease()
            self._report_unserved(decision.unserved)
            if decision.must_read_again and self._is_whole:
                self._doubted.set()
            now = await self._until_due()

    async def _until_due(self) -> float:
        """Wait until a decision is due; return the time, which is not before that."""
        self._woken.clear()
        settings = self.worker.view.settings
        shortest = min(COARSEST_S, EXACTNESS * settings.lease if settings else COARSEST_S)
        now = self.now()
        pause = max(shortest, min(self.worker.due, self._leave_by) - now)
        try:
            async with asyncio.timeout(pause):
                await self._woken.wait()
        except TimeoutError:  # asyncio ends timers early, if only by the resolution of its clock
            return max(self.now(), now + pause)
        return self.now()

    # --- devices --------------------------------------------------------------------------------

    def _poll(self, active: Mapping[str, Connection]) -> None:
        """Set the devices of the fleet to those of the active connections."""
        if active == self._active:
            return
        self._devices = {
            key: self._devices[key] if self._active.get(key) == item else self._read(item)
            for key, item in active.items()
        }
        self._active = active
        # Devices of one name, which only other programs write, would be refused.
        devices = {item.name: item for group in self._devices.values() for item in group}
        self.fleet.replace(list(devices.values()), passed_on=self._passed_on())

    def _passed_on(self) -> set[str]:
        """Return the connections that other workers can poll."""
        now, view, me = self.now(), self.worker.view, self.worker.id
        zones = {
            zone
            for member in view.members.values()
            if member.id != me and view.is_heard(member, now)
            for zone in member.zones
        }
        return {connection.key for connection in view.connections if connection.zone in zones}

    def _read(self, connection: Connection) -> list[DeviceConfig]:
        try:
            return devices_of(connection)
        except ValueError as error:
            # No record may stop a worker: others would take over the connection, and stop as well.
            self._log_problem(str(error))
            return []

    def _report_unserved(self, connections: Sequence[Connection]) -> None:
        """Report the devices of connections that no worker polls "offline", each once."""
        for connection in connections:
            if connection.key not in self._unserved:
                self.fleet.report_offline(self._read(connection))
        self._unserved = {connection.key for connection in connections}

    def _refusal(self, device: str) -> str | None:
        """Return the refusal of a command, as `Commands` needs it."""
        if device not in self.fleet.devices:
            return refusal(self.worker, device, self.now())
        # After its lease, another worker may have carried out the same command.
        return None if self.worker.may_poll(self.now()) else ""

    def _report(self) -> dict[str, Any]:
        statistics, now = self.fleet.statistics, self.now()
        polls, at = self._polls
        if now - at >= 1.0:
            self._rate = (statistics.polls - polls) / (now - at)
            self._polls = statistics.polls, now
        return {
            "connections": len(self._active),
            "devices": statistics.devices,
            "up": statistics.up,
            "down": statistics.down,
            "polls": round(self._rate, 1),
        }

    # --- log ------------------------------------------------------------------------------------

    def _log_lease(self) -> None:
        """Log whether the lease is valid, when that changes, and what cannot be read."""
        until, settings, now = self.worker.lease_until, self.worker.view.settings, self.now()
        if (now < until) != self._was_valid and self.worker.has_joined:
            self._was_valid = not self._was_valid
            if self._was_valid:
                logger.warning("%s: the lease is valid again", self._name)
            else:
                logger.warning("%s: the lease has expired: NATS does not respond", self._name)
                # Later, other workers may poll the devices already.
                is_early = settings and now < until + (1.0 - OWN_PART) * settings.lease
                if is_early and not self.worker.may_poll(now):
                    self.fleet.take_back()
        for problem in self.worker.view.unreadable.values():
            self._log_problem(f"the bucket: {problem}")

    def _log_problem(self, text: str) -> None:
        """Log a line, unless it was logged within the last minute."""
        now = self.now()
        if now > self._reports.get(text, -math.inf) + REPORT_AGAIN_S:
            if len(self._reports) > MOST_REPORTS:
                self._reports.clear()
            self._reports[text] = now
            logger.warning("%s", text)
