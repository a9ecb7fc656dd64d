"""
One device while it is polled, and the connection that it shares with others.

A poll is requests, each after the outcome of the one before. The first waits for its turn, the
others come before those of other devices, because the values of a poll should be read together. If
the first is not answered, the poll is over and the device is down; its next poll is a trial. If a
request is refused, the poll goes on until it is known which points the device refuses.

After a write the device is polled once more, so that the new value is reported at once. One poll
follows several writes in a row, and reports the points that were written even if they have their
old values.
"""

from __future__ import annotations

import asyncio
import errno
import math
from collections.abc import Awaitable, Callable, Collection, Generator, Iterable, Iterator, Sequence
from enum import Enum
from functools import partial
from itertools import count, repeat
from typing import Any, NamedTuple

from ...client.asynchronous import AsyncClient
from ...client.reconnecting import State
from ...client.sender import Sender
from ...maps.plan import unreadable_of
from ...maps.refusals import PartialAnswer, Refusals, UnreadableItem, is_refusal, reading
from ...maps.watched import TOLERANCE, PointIntervals, Totals
from ...protocol.errors import ModbusConnectionError, ModbusError
from ...protocol.logs import HarmlessLogger
from ..line import FairQueue, LineRequest, SharedLine, pause_after
from .config import DeviceConfig, Reads
from .readings import Changes, Reading, classification, is_down
from .statistics import FleetStatistics

logger: HarmlessLogger = HarmlessLogger(__name__)

LONGEST_PAUSE_S = 60.0
"""The time between two trials of a device that does not answer, unless its interval is longer."""

PAUSE_S = 0.05
"""Seconds from the last of several writes in a row to the poll that reads the new values."""

MayAsk = Callable[[str], bool]


class DeviceState(Enum):
    """NEW until the first poll of a device is over."""

    NEW = "new"
    UP = "up"
    DOWN = "down"


class LastValue(NamedTuple):
    """The value of a point when it was last read, or the reason why there was no good one."""

    name: str
    units: str
    value: Any
    reason: str = ""


class Poller(LineRequest):
    """
    A device of a fleet: its current poll, its state, and its reported values.

    `error` is the first of the last poll; None if all points were read. The fleet sets when the
    next poll begins (`at`), in the time of the event loop; and in seconds since the epoch, 0 at
    first, when the device last answered and since when it is up or down.
    """

    def __init__(self, config: DeviceConfig) -> None:
        super().__init__(config.unit)
        self.config: DeviceConfig = config
        self.name: str = config.name
        self.reads: Reads = config.reads
        self.at: float = math.inf
        self.answered_at: float = 0.0
        self.pause_until: float = 0.0
        own = self.reads.intervals
        self._pace = PointIntervals(own, config.interval) if any(own) else None
        self._due: tuple[int, ...] | None = None
        self._refusals = Refusals()
        # Writes under way, and what ends the pause after the last one; whether the device was
        # written to since the last poll began, and the indexes of these points.
        self.writes: int = 0
        self.pause_after_write: asyncio.TimerHandle | None = None
        self.is_written: bool = False
        self._written: set[int] = set()
        self._first = 0  # the index of the request of a plan that is asked first
        self._answers: list[Any] = []
        self.forget()

    def forget(self) -> None:
        """Forget the state of the device, and its reported values."""
        self.state: DeviceState = DeviceState.NEW
        self.was_reported: bool = False  # with other keys, before the fleet was changed
        self.since: float = 0.0
        self.error: Exception | None = None
        names, config = self.reads.names, self.config
        self._values: list[Any] = [None] * len(names)
        self._reasons: dict[int, str] = {}  # why the last reading of a point is not good
        again = None
        if config.at_least is not None:
            # At the last poll that is not too late.
            own = (item or config.interval for item in self.reads.intervals)
            again = [config.at_least - item * (1 - TOLERANCE) for item in own]
        bands = [config.dead_bands.get(item) for item in names]
        self._changes = Changes(config.on_change, bands, again)
        self._totals = Totals(at for at, item in enumerate(names) if config.map[item].never_falls)

    @property
    def interval(self) -> float:
        """Seconds from one poll to the next."""
        return self.config.interval if self._pace is None else self._pace.interval

    @property
    def pause(self) -> float:
        """Seconds for which the device is paused after a poll without an answer."""
        return pause_after(self.misses, self.interval, LONGEST_PAUSE_S)

    @property
    def is_refused(self) -> bool:
        """True if the device answered, but refused a request."""
        return self.state is DeviceState.UP and self.error is not None

    @property
    def bad_points(self) -> dict[str, str]:
        """The points that have no good value although the device answers, each with the reason."""
        reasons = self._reasons.copy() if self.state is DeviceState.UP else {}
        return {self.reads.names[at]: reason for at, reason in reasons.items()}

    def last_values(self) -> Iterator[LastValue]:
        """Yield the points that have been read; none while the device does not answer."""
        if self.state is DeviceState.UP:
            points = zip(self.reads.names, self.reads.units, self._values, strict=True)
            for at, (name, units, value) in enumerate(points):
                if reason := self._reasons.get(at, ""):
                    yield LastValue(name, units, None, reason)
                elif value is not None:
                    yield LastValue(name, units, classification(value)[0])

    @property
    def is_reported(self) -> bool:
        """True if points of the device were reported, and not taken back."""
        return self.was_reported or self.state is not DeviceState.NEW

    @property
    def unreadable(self) -> list[UnreadableItem]:
        """The points that the device refuses, and that are left out until they are tried again."""
        device = f"{self.config.endpoint}, unit {self.config.unit}"
        return unreadable_of(self.reads.plan, self._refusals, device)

    def note_written(self, names: Iterable[str]) -> None:
        """Note points that were written: the next poll reads and reports them in any case."""
        written_names = set(names)
        self.is_written = True
        own = enumerate(self.reads.names)
        self._written.update(at for at, name in own if name in written_names)

    def cancel_pause(self) -> None:
        """Do not poll the device because of a write."""
        if self.pause_after_write is not None:
            self.pause_after_write.cancel()

    # --- a poll -----------------------------------------------------------------------------

    def begin(self, due_at: float = 0.0, connects: int = 1) -> None:
        """Begin a poll that is due at `planned`; the client has made so many connections."""
        self.waits_since = due_at
        if self._pace is not None:
            due = self._pace.due(due_at)
            self._due = None if due is None else tuple(sorted({*due, *self._written}))
        self.is_written = False
        for at in self._written:
            self._changes.forget(at)
        self._written.clear()
        self._plan = self.reads.plan_of(self._due)
        self._time = due_at, connects
        self._first_error: ModbusError | None = None
        self._is_answered = False
        self._steps: Generator[Any, Any, list[Any]] | None = None
        self._outcomes: list[Any] = []
        self._requests: Sequence[Any] = self._search() if self._refusals else self._plan.requests
        self._advance()

    def take_outcome(self, outcome: Any, now: float) -> None:
        """Take the outcome of the request; with the last one, the state of the device changes."""
        is_error = isinstance(outcome, ModbusError)
        if is_error and self._first_error is None:
            self._first_error = outcome
        self._outcomes.append(outcome)
        if not (is_error and is_down(outcome)):
            self._is_answered = True
        elif not self._is_answered:
            self._outcomes += [outcome] * (len(self._requests) - len(self._outcomes))
        if len(self._outcomes) == len(self._requests):
            self._go_on()
        self.pause_until = now + self.config.spacing
        self._advance()
        if self.request is not None:
            return
        self._steps, self._outcomes = None, []  # thousands of devices would keep them
        self.error = self._first_error
        self.misses: int = 0 if self._is_answered else self.misses + 1
        if self.misses:
            # The device may be silent about this request only, so that another one comes first.
            self._first += 1
        self.state = DeviceState.DOWN if self.misses else DeviceState.UP

    def _advance(self) -> None:
        answer_count, requests = len(self._outcomes), self._requests
        is_over = answer_count == len(requests)
        at = (self._first + answer_count) % len(requests)
        self.request: Any = None if is_over else requests[at]

    def _search(self) -> Sequence[Any]:
        """Begin to leave out what is refused; return the first requests."""
        tell = partial(logger.warning, "%s: cannot be read: %s", self.name)
        self._steps = reading(self._plan.blocks, self._refusals, *self._time, tell=tell)
        return next(self._steps)

    def _go_on(self) -> None:
        """Search for what was refused, or end the poll."""
        # The first request was not the first one of the plan.
        first = len(self._outcomes) - self._first % len(self._outcomes)
        outcomes = self._outcomes[first:] + self._outcomes[:first]
        if self._steps is None:
            self._answers = outcomes
            if not any(map(is_refusal, outcomes)):
                return
            self._search()
        assert self._steps is not None
        try:
            self._requests, self._outcomes = self._steps.send(outcomes), []
        except StopIteration as stop:
            self._answers = stop.value
            if self._first_error is None:
                self._first_error = next(filter(None, map(_error_of, self._answers)), None)

    # --- its readings -------------------------------------------------------------------------

    def values(self) -> dict[str, Any]:
        """Return the values of the poll that is over by name, with errors for missing ones."""
        answers, self._answers = self._answers, []
        results: dict[str, Any] = self._plan.results(answers, return_exceptions=True)
        return results

    def readings(self, time: float, first: int) -> list[Reading]:
        """Return the readings of the poll that is over, with ids from `first` on; 0 for no ids."""
        names = self.reads.names
        values = [*map(self.values().get, names)]
        doubtful, fell = self._totals.take(values)
        if self._pace is not None:
            missing = {
                at
                for at, value in enumerate(values)
                if isinstance(value, ModbusError) and is_down(value)
            }
            self._pace.done(missing | doubtful)
        due = self._due
        if doubtful:
            every = range(len(names)) if due is None else due
            due = tuple(at for at in every if at not in doubtful)
        positions = self._changes.pick(values, due, self._time[0])
        if due is None:
            self._values = values
        else:
            for at in due:
                self._values[at] = values[at]
        if self._reasons:
            for at in positions:
                self._reasons.pop(at, None)
        device, units, labels, readings = self.name, self.reads.units, self.config.labels, []
        for at, number in zip(positions, count(first) if first else repeat(0), strict=False):
            value, quality, reason = classification(values[at])
            if quality != "good":
                self._reasons[at] = reason
            elif fell and at in fell:
                reason = "Fell"
            # As Reading(...), in half the time: a fleet does little else.
            fields = time, device, names[at], value, units[at], quality, reason, number, labels
            readings.append(tuple.__new__(Reading, fields))
        return readings

    def offline_readings(self, time: float, still_read: Collection[str] = ()) -> list[Reading]:
        """Return readings that take back those that were reported, without the points named."""
        return offline(self.config, time, still_read) if self.is_reported else []


def _error_of(answer: Any) -> ModbusError | None:
    """Return why an answer, or a part of it, is missing."""
    if isinstance(answer, PartialAnswer):
        return next(iter(answer.errors.values()), None)
    return answer if isinstance(answer, ModbusError) else None


def offline(device: DeviceConfig, time: float, still_read: Collection[str] = ()) -> list[Reading]:
    """Return readings that take back the points of a device, without those named."""
    points = [device.map[name] for name in device.names if name not in still_read]
    return [
        Reading(time, device.name, point.name, None, point.units, "offline", labels=device.labels)
        for point in points
    ]


class FleetLine(SharedLine[Poller]):
    """
    Polls the devices of one connection in the order in which they are due.

    `on_polled` is called after each poll with the state before it, None if it was not sent;
    `on_back` with each device that was down because there was no connection.
    """

    def __init__(
        self,
        config: DeviceConfig,
        may_ask: MayAsk | None,
        statistics: FleetStatistics,
        on_polled: Callable[[Poller, DeviceState | None], None],
        on_back: Callable[[Poller], None],
    ) -> None:
        self._is_gated = may_ask is not None
        self.url: str = config.endpoint.url
        gate = None if may_ask is None else partial(may_ask, config.connection_key)
        client = AsyncClient(self.url, may_send=gate, on_state=self._note_state)
        super().__init__(Sender(client), FairQueue, most_trials=1)
        self.pollers: dict[str, Poller] = {}
        self._senders: dict[float | None, Sender] = {None: self.sender}
        self._statistics = statistics
        self._on_polled = on_polled
        self._on_back = on_back

    def sender_of(self, job: Poller) -> Sender:
        timeout = job.config.timeout
        if timeout not in self._senders:
            self._senders[timeout] = Sender(self.client.for_unit(1, timeout=timeout))
        return self._senders[timeout]

    def due(self, poller: Poller, due_at: float) -> None:
        """Poll a device, unless its last poll is still under way."""
        if poller.request is not None:
            self._statistics.skipped += 1
            return
        poller.is_urgent, poller.is_trial = False, poller.state is DeviceState.DOWN
        poller.begin(due_at, self.client.statistics.connects)
        self.ask(poller, self._loop.time())

    async def poll_after(
        self, writing: Awaitable[None], poller: Poller, names: Iterable[str]
    ) -> None:
        """Wait for a write to points of a device, and poll it soon."""
        poller.writes += 1
        try:
            await writing
            poller.note_written(names)
        finally:
            poller.writes -= 1
            self._poll_soon(poller)

    def _poll_soon(self, poller: Poller) -> None:
        poller.cancel_pause()
        if self.pollers.get(poller.name) is poller:  # it may have been removed meanwhile
            poller.pause_after_write = self._loop.call_later(PAUSE_S, self._poll_written, poller)

    def _poll_written(self, poller: Poller) -> None:
        """Poll a device, unless a poll has read what was written, or another write is under way."""
        if poller.writes or not poller.is_written:
            return
        if poller.request is not None:  # a poll that may have read the point before it was written
            self._poll_soon(poller)
        else:
            self.due(poller, self._loop.time())

    def _ready_at(self, job: Poller) -> float:
        return max(super()._ready_at(job), job.pause_until)

    def _end_overstayed(self, now: float) -> None:
        if any(poller.pause_until <= now for poller in self.others()):  # the others wait
            super()._end_overstayed(now)

    def _send(self, job: Poller, now: float) -> None:
        if not job.is_urgent:
            self._statistics.note_start(max(0.0, now - job.waits_since))
        super()._send(job, now)

    def conclude(self, job: Poller, outcome: Any, now: float) -> None:
        """Pass the outcome of a request to its poll, which continues or is over."""
        # Requests that `may_ask` refused fail with EPERM.
        if self._is_gated and getattr(outcome, "errno", 0) == errno.EPERM:
            job.request = None
            self._statistics.vetoes += 1
            self._on_polled(job, None)
            return
        before = job.state
        job.take_outcome(outcome, now)
        if job.request is None:
            self._on_polled(job, before)
        else:
            job.is_urgent = True
            self.ask(job, now)

    def _note_state(self, state: State, error: ModbusError | None) -> None:
        for poller in self.pollers.values() if state is State.CONNECTED else ():
            if isinstance(poller.error, ModbusConnectionError):
                self._on_back(poller)
