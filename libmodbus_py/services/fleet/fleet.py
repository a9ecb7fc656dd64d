"""The fleet: devices on many lines, polled when they are due; readings are passed to outputs."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import partial
from hashlib import blake2b
from heapq import heapify, heappop, heappush
from itertools import count
from os import PathLike
from typing import Any, Self

from ...maps.writing import json_value
from ...ports.waiting import Alarm
from ...protocol.checks import checked_callback
from ...protocol.logs import HarmlessLogger
from ...protocol.mistakes import inside, named_arguments
from ..tasks import KeptTasks
from .commands import Commands
from .config import DeviceConfig, checked_devices
from .files import load
from .journal.journal import Journal
from .outputs.output import Output
from .poller import DeviceState, FleetLine, MayAsk, Poller, offline
from .readings import MOST_KEPT, Buffer
from .receivers import Receivers
from .rewriting import Rewrites
from .statistics import FleetStatistics

logger: HarmlessLogger = HarmlessLogger(__name__)

# The most devices per second that are polled if each is polled once only.
ONCE_A_SECOND = 1000.0

# The most polls that begin in one turn of the event loop: it takes about 10 ms. After the loop was
# blocked, or the machine suspended, thousands are due at once.
MOST_AT_ONCE = 200

# Polls that are due within the same step begin together, at its end: with 2000 polls a second that
# takes a sixth less of the processor, because each turn of the event loop costs as much as a poll.
STEP_S = 0.005


def first_time(name: str, interval: float, now: float, wall: float) -> float:
    """
    Return the first time of a device, `wall` being the time of day now, in seconds since the epoch.

    Its phase is derived from its name and the time of day, so that every machine polls it at the
    same moments, and thousands are never polled at once.
    """
    digest = blake2b(name.encode(), digest_size=8).digest()
    phase = int.from_bytes(digest, "big") / 2**64 * interval
    return now + (phase - wall) % interval


def next_time(due: float, interval: float, now: float) -> tuple[float, int]:
    """Return the first time after now, and how many earlier times are skipped."""
    skips = max(0, int((now - due) // interval))
    return due + (skips + 1) * interval, skips


@named_arguments
class Fleet:
    """
    Polls many devices, each at its interval, with asyncio.

    Devices with the same URL share a connection. Their phases are spread, so that thousands of
    polls do not begin at once. A device that does not answer is paused, longer each time up to a
    minute, and delays the other devices of its line by no more than the time of one answer. A
    poll that is due while the previous poll of the device is still under way is skipped and
    counted.

    ::

        async with Fleet(devices) as fleet:
            async for reading in fleet.readings():
                print(reading.device, reading.name, reading.value)

    Args:
        devices: the first devices; `add`, `remove` and `replace` change them.
        outputs: receive all readings.
        journal: keeps the readings on the disk for outputs that are away; None for none. A
            journal can be used by one fleet only.
        may_ask: called with the `connection_key` of a device before the fleet connects to the
            device, and before each request is sent. While it returns False, nothing is sent, and
            polls are counted as `vetoes`. It must not block.

    Attributes:
        statistics: counters of polls, readings and outputs.
        commands: carries out the writes that outputs receive.

    Raises:
        TypeError, ValueError: two devices have the same name, or two URLs with different
            options lead to the same host and port or serial port; two outputs write to the same
            file or topic, or one to a file of the journal.
        JournalError: when polling begins: the journal cannot be used.
    """

    def __init__(
        self,
        devices: Iterable[DeviceConfig] = (),
        *,
        outputs: Sequence[Output] = (),
        journal: Journal | None = None,
        may_ask: MayAsk | None = None,
    ) -> None:
        self._devices = {device.name: device for device in checked_devices(devices)}
        self._may_ask = None if may_ask is None else checked_callback("may_ask", may_ask)
        self.statistics: FleetStatistics = FleetStatistics()
        self.commands: Commands = Commands(self)
        self._receivers = Receivers(outputs, journal, self.statistics)
        self._lines: dict[str, FleetLine] = {}
        self._pollers: dict[str, Poller] = {}
        self._closing = KeptTasks()
        self._rewrites: dict[str, Rewrites] = {}
        self._loop: asyncio.AbstractEventLoop | None = None
        # True to poll each device once; the devices that are still to be polled then.
        self._once = False
        # A heap: when each device is polled next. A plan is void if `Poller.at` differs.
        self._plans: list[tuple[float, int, Poller]] = []
        self._numbers = count()  # of plans: those for the same time keep their order
        self._alarm = Alarm(self._poll_due)
        self._unpolled: set[str] = set()
        self._is_over = asyncio.Event()
        # Seconds from the time of the event loop to the time of day when the fleet started:
        # phases are the same on all machines, and setting the clock moves no poll.
        self._wall = 0.0

    @classmethod
    def from_file(cls, path: str | PathLike[str], *, may_ask: MayAsk | None = None) -> Self:
        """
        Return the fleet that a file describes, with its outputs.

        Raises:
            FleetFileError: a ValueError that names the file, the line, the key and the allowed
                values.
        """
        file = load(path)
        outputs, journal = file.make_outputs(), file.make_journal()
        return cls(file.devices, outputs=outputs, journal=journal, may_ask=may_ask)

    # --- life -------------------------------------------------------------------------------

    async def __aenter__(self) -> Self:
        await self._start()
        self._receivers.log_ends()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._stop()

    async def run(self, *, once: bool = False) -> None:
        """
        Poll until cancelled.

        Args:
            once: True to poll each device once and return.

        Raises:
            OutputError: an output failed permanently.
            JournalError: the journal cannot be used.
        """
        self._once = once
        await self._start()
        try:
            self._end_if_all_polled()
            await self._receivers.wait_for_end(self._is_over)
        finally:
            await self._stop()

    def _end_if_all_polled(self) -> None:
        if self._once and not self._unpolled:
            self._is_over.set()

    async def _start(self) -> None:
        if self._loop is not None:
            raise RuntimeError("this fleet is already polling; make another one")
        self._receivers.describe(self._devices)
        await self._receivers.start(self.commands)
        self._loop = asyncio.get_running_loop()
        self._wall = time.time() - self._loop.time()
        for device in self._devices.values():
            self._begin(device)

    async def _stop(self) -> None:
        for key in list(self._lines):
            self._end_line(key)
        self._alarm.cancel()
        self._plans.clear()
        try:
            await self._receivers.stop(self._closing, is_patient=self._is_over.is_set())
        finally:
            self._loop = None

    # --- devices ------------------------------------------------------------------------------

    @property
    def devices(self) -> Mapping[str, Poller]:
        """The state of each device that is polled, by the name of the device."""
        return self._pollers

    def add(self, devices: Iterable[DeviceConfig]) -> None:
        """
        Add devices to those that are polled.

        Raises:
            TypeError, ValueError: as for `Fleet`; the devices do not change then.
        """
        self.replace([*self._devices.values(), *devices])

    def remove(self, connection_key: str) -> None:
        """Remove the devices of a connection. Nothing is sent to them after this returns."""
        self.replace(
            [device for device in self._devices.values() if device.connection_key != connection_key]
        )

    def replace(self, devices: Iterable[DeviceConfig], *, passed_on: Collection[str] = ()) -> None:
        """
        Replace all devices. Polling of devices that are equal to existing ones is not interrupted.

        Points that were reported and are not polled any more are reported once more, with the
        quality "offline".

        Args:
            passed_on: the `connection_key` of devices that are not reported "offline", because
                another fleet polls them from now on.

        Raises:
            TypeError, ValueError: as for `Fleet`; the devices do not change then.
        """
        after = {device.name: device for device in checked_devices(devices)}
        before = self._devices
        if self._loop is None:
            self._devices = after
            return
        try:
            self._receivers.describe(after)
        except ValueError:
            self._receivers.describe(before)
            raise
        self._devices = after
        now, reported = time.time(), set[str]()
        for name, poller in list(self._pollers.items()):
            still = after.get(name)
            if still == poller.config:
                continue
            if poller.is_reported:
                reported.add(name)
            if poller.config.connection_key not in passed_on:
                self._receivers.put_readings(
                    poller.offline_readings(now, still.names if still else ())
                )
            self._end(poller)
        urls = {device.connection_key: device.endpoint.url for device in after.values()}
        ended_keys = [key for key, line in self._lines.items() if line.url != urls.get(key)]
        for key in ended_keys:
            self._end_line(key)
        self._plans = [plan for plan in self._plans if plan[2].name in self._pollers]
        heapify(self._plans)
        for device in after.values():
            if device.name not in self._pollers:
                self._begin(device)
                self._pollers[device.name].was_reported = device.name in reported
        self._end_if_all_polled()

    def take_back(self) -> None:
        """
        Report all points as "offline" until their devices are polled again: while `may_ask`
        returns False, the last values may be wrong.
        """
        now = time.time()
        for poller in self._pollers.values():
            self._receivers.put_readings(poller.offline_readings(now))
            self._count(poller.state, -1)
            poller.forget()

    def report_offline(self, devices: Iterable[DeviceConfig]) -> None:
        """Report all points of devices that no fleet polls as "offline"."""
        now = time.time()
        for device in devices:
            self._receivers.put_readings(offline(device, now))

    def _begin(self, device: DeviceConfig) -> None:
        assert self._loop is not None
        poller = self._pollers[device.name] = Poller(device)
        key = device.connection_key
        if key not in self._lines:
            self._lines[key] = FleetLine(
                device, self._may_ask, self.statistics, self._polled, self._poll_after
            )
        self._lines[key].pollers[device.name] = poller
        self.statistics.devices += 1
        now = self._loop.time()
        interval = poller.interval
        if self._once:
            self._unpolled.add(device.name)
            interval = min(interval, len(self._devices) / ONCE_A_SECOND)
        self._plan(poller, first_time(device.name, interval, now, now + self._wall))
        self._set_alarm()

    def _end(self, poller: Poller) -> None:
        del self._pollers[poller.name]
        if (rewrites := self._rewrites.pop(poller.name, None)) is not None:
            rewrites.end()
        line = self._lines[poller.config.connection_key]
        del line.pollers[poller.name]
        line.withdraw(poller)
        poller.cancel_pause()
        self._unpolled.discard(poller.name)
        self._count(poller.state, -1)
        self.statistics.devices -= 1

    def _end_line(self, key: str) -> None:
        line = self._lines[key]
        for poller in list(line.pollers.values()):
            self._end(poller)
        del self._lines[key]
        self._closing.begin(line.close())

    # --- polls ----------------------------------------------------------------------------------

    def _plan(self, poller: Poller, at: float) -> None:
        if at != poller.at:
            poller.at = at
            heappush(self._plans, (at, next(self._numbers), poller))

    def _poll_due(self, now: float) -> None:
        """Begin the polls whose time has come, and set the alarm for the next one."""
        for _ in range(MOST_AT_ONCE):
            if not self._plans or self._plans[0][0] > now:
                break
            due, _, poller = heappop(self._plans)
            if due != poller.at:
                continue
            if not self._once:
                at, skips = next_time(due, poller.interval, now)
                self.statistics.skipped += skips
                self._plan(poller, at)
            self._lines[poller.config.connection_key].due(poller, due)
        self._set_alarm()

    def _set_alarm(self) -> None:
        if self._plans and self._loop is not None:
            at = self._plans[0][0]
            self._alarm.set(max(at, math.ceil(at / STEP_S) * STEP_S), self._loop)

    def _polled(self, poller: Poller, before: DeviceState | None) -> None:
        """Report a poll that is over; `before` is None if nothing was sent."""
        if before is not None:
            now = time.time()
            self._count_poll(poller, before, now)
            self._receivers.put_readings(poller.readings(now, self._receivers.next_id))
            if poller.misses:
                self._poll_after(poller, poller.pause)
        self._unpolled.discard(poller.name)
        self._end_if_all_polled()

    def _count_poll(self, poller: Poller, before: DeviceState, now: float) -> None:
        statistics = self.statistics
        statistics.polls += 1
        statistics.failures += poller.misses > 0
        statistics.refusals += poller.is_refused
        if not poller.misses:
            poller.answered_at = now
        if poller.state is not before:
            self._count(before, -1)
            self._count(poller.state, 1)
            poller.since = now
            why = f": {poller.error}" if poller.misses else ""
            logger.info("%s is %s%s", poller.name, poller.state.value, why)

    def _count(self, state: DeviceState, by: int) -> None:
        self.statistics.up += by * (state is DeviceState.UP)
        self.statistics.down += by * (state is DeviceState.DOWN)

    def _poll_after(self, poller: Poller, pause: float = 0.0) -> None:
        """Poll a device at the first of its times after a pause, and not before."""
        if self._loop is not None and not self._once:
            due, now = poller.at, self._loop.time()
            times = (now + pause - due) // poller.interval + 1
            self._plan(poller, due + times * poller.interval)
            self._set_alarm()

    # --- readings ----------------------------------------------------------------------------

    def readings(self, buffer: int = MOST_KEPT) -> Buffer:
        """
        Return the readings from now on, until the fleet stops, for ``async for``; its attribute
        `dropped` counts those that were lost.

        Args:
            buffer: the most readings that wait for the iteration, 1..10000000; the oldest are
                dropped beyond.

        Raises:
            TypeError, ValueError: `buffer` has the wrong type or range.
        """
        return self._receivers.iterate(buffer)

    def unknown(self, device: str, point: str) -> str:
        """Return which of two names is unknown, in a sentence; "" if the device has the point."""
        poller = self._pollers.get(device)
        if poller is None:
            return f"there is no device {device!r}"
        return "" if point in poller.config.map else f"{device} has no point {point!r}"

    async def write(self, device: str, values: Mapping[str, Any]) -> None:
        """
        Write values to points of a device, by their names; it is polled at once thereafter.

        Args:
            device: the name of the device.
            values: as for `write_map` of the clients; times may be text (ISO 8601), as in JSON.
                Those of points with `rewrite` are written again, until the next write.

        Raises:
            KeyError: the fleet has no device of this name.
            TypeError, ValueError: the device has no such point, the point is read-only, or it
                cannot have this value. Nothing was sent.
            ModbusError: as for `AsyncClient`.
        """
        poller = self._pollers[device]
        points = poller.config.map
        writes = dict(values)
        for name in points.keys() & writes.keys():
            with inside(name):
                writes[name] = json_value(points[name], writes[name])
        if device not in self._rewrites:
            self._rewrites[device] = Rewrites(
                device, points, partial(self._send, poller), self._closing
            )
        writing = self._rewrites[device].write(writes)
        await self._lines[poller.config.connection_key].poll_after(writing, poller, writes)

    async def _send(self, poller: Poller, values: Mapping[str, Any]) -> None:
        line = self._lines[poller.config.connection_key]
        function = poller.config.write_function
        plc = line.sender_of(poller).client.for_unit(poller.unit, write_function=function)
        await plc.write_map(poller.config.map, values)
