"""
One device while it is polled: the state of its poll, and of the device.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from enum import Enum
from typing import Any

from ...client.asynchronous import Submitted
from ...maps.holes import Holes, PartialAnswer, PlanSteps, Unreadable, is_refusal, reading
from ...maps.plan import unreadable_of
from ...maps.point_plan import PointPlan
from ...maps.watched import PointIntervals, Totals
from ...protocol.errors import ModbusError
from ..waiting_room import rest_after
from .config import DeviceConfig
from .readings import NO_LABELS, Changes, Reading, is_down, judged

__all__ = ["LONGEST_REST", "DeviceState", "Poller", "Reads"]

LONGEST_REST = 60.0
"""Seconds between two trials of a device that does not answer, unless its interval is longer."""


MOST_PLANS = 64
"""Plans for different sets of points of a kind of device that are kept."""


class DeviceState(Enum):
    """The state of a device."""

    NEW = "new"
    UP = "up"
    DOWN = "down"


class Reads:
    """
    The requests and points of a kind of device; thousands of devices share one object.

    Args:
        config: of one of these devices.
    """

    __slots__ = ("__weakref__", "_config", "_intervals", "_plans", "names", "plan", "units")

    def __init__(self, config: DeviceConfig) -> None:
        self.plan: PointPlan = config.plan()
        self.names: tuple[str, ...] = config.names
        self.units: tuple[str, ...] = tuple(config.map[name].units for name in config.names)
        own = tuple(config.map[name].interval for name in config.names)
        self._intervals = own if any(each is not None for each in own) else ()
        self._config = config
        self._plans: dict[tuple[int, ...], PointPlan] = {}

    def pace(self, interval: float) -> PointIntervals | None:
        """Return the intervals of the points of a device; None if none has its own."""
        return PointIntervals(self._intervals, interval) if self._intervals else None

    def plan_of(self, due: tuple[int, ...] | None) -> PointPlan:
        """Return the requests that read the points with some indexes; None for all."""
        if due is None:
            return self.plan
        if due not in self._plans:
            if len(self._plans) == MOST_PLANS:
                self._plans.clear()
            self._plans[due] = self._config.plan([self.names[at] for at in due])
        return self._plans[due]


class Poller:
    """
    Produces the requests of a device and takes their outcomes; sends nothing itself.

    Args:
        config: of the device.
        reads: the requests and points of the device.

    Attributes:
        name: of the device.
        unit: of the device.
        next_request: of the current poll; None when the poll is over.
        state: NEW until its first poll is over.
        told_state: the state that the statistics count.
        error: the first error of the last poll, or that of a point that was left out; None if all
            points were read.
        at: when the device is polled next, or was polled last.
        planned: when the current poll was due; None without one.
        misses: polls in a row without an answer.
        submitted: the request that is in flight, or None.
        asked_at: when the request in flight was sent.
        answered_at: when the last poll that was answered was over, in seconds since the epoch; 0
            before the first.
        since: since when the device is up or down, in seconds since the epoch; 0 if NEW.
        rest_until: when the next request may be sent to the device.
        waits_since: when the current poll was due.
        news: sentences about points that the device was found to refuse, until they are logged.
    """

    # fmt: off
    __slots__ = (
        "_answers",
        "_changes",
        "_due",
        "_error",
        "_first",
        "_has_answered",
        "_holes",
        "_pace",
        "_plan",
        "_requests",
        "_steps",
        "_taken",
        "_time",
        "_totals",
        "answered_at",
        "asked_at",
        "at",
        "config",
        "error",
        "is_trial",
        "misses",
        "name",
        "news",
        "next_request",
        "planned",
        "reads",
        "rest_until",
        "since",
        "state",
        "submitted",
        "told_state",
        "unit",
        "waits_since",
    )
    # fmt: on

    def __init__(self, config: DeviceConfig, reads: Reads) -> None:
        self.config: DeviceConfig = config
        self.name: str = config.name
        self.unit: int = config.unit
        self.next_request: Any = None
        self.reads: Reads = reads
        self.state: DeviceState = DeviceState.NEW
        self.told_state: DeviceState = DeviceState.NEW
        self.error: Exception | None = None
        self.at: float = 0.0
        self.planned: float | None = None
        self.misses: int = 0
        self.is_trial: bool = False
        self.submitted: Submitted | None = None
        self.answered_at: float = 0.0
        self.since: float = 0.0
        self.asked_at: float = 0.0
        self.rest_until: float = 0.0
        self.waits_since: float = 0.0
        self.news: list[str] = []
        self._answers: list[Any] = []
        self._pace = reads.pace(config.interval)
        self._due: tuple[int, ...] | None = None
        self._plan = reads.plan
        self._requests: Sequence[Any] = reads.plan.requests
        self._steps: PlanSteps[list[Any]] | None = None
        self._holes: Holes | None = None
        self._time = 0.0, 1
        self._error: ModbusError | None = None
        self._first = 0
        self._taken: list[Any] = []
        self._has_answered = False
        self._changes = _changes(config, reads)
        self._totals = _totals(config, reads)

    @property
    def interval(self) -> float:
        """Seconds from one poll to the next."""
        return self.config.interval if self._pace is None else self._pace.interval

    @property
    def has_begun(self) -> bool:
        return self._has_answered or bool(self._taken)

    @property
    def unreadable(self) -> list[Unreadable]:
        """The points that the device refuses, and that are left out until they are tried again."""
        if self._holes is None:
            return []
        device = f"{self.config.endpoint}, unit {self.config.unit}"
        return unreadable_of(self.reads.plan, self._holes, device)

    def begin(self, now: float = 0.0, connects: int = 1) -> None:
        """
        Begin a poll; earlier responses are dropped.

        Args:
            now: the time in seconds, of any steady clock.
            connects: how many connections the client of the device has made.
        """
        self._time = now, connects
        self._answers, self._taken = [], []
        self._has_answered = False
        self._error = None
        if self._pace is not None:
            self._due = self._pace.due(now if self.planned is None else self.planned)
            self._plan = self.reads.plan_of(self._due)
        self._steps, self._requests = None, self._plan.requests
        if self._holes:
            self._requests = self._new_steps(self._holes)
        self._advance()

    def _new_steps(self, holes: Holes) -> Sequence[Any]:
        """Begin to leave out what is refused; return the first requests."""
        self._steps = reading(self._plan.blocks, holes, *self._time, tell=self.news.append)
        return next(self._steps)

    def take(self, outcome: Any) -> None:
        """Take a response or an error; a poll ends if its first request is not answered."""
        is_error = isinstance(outcome, ModbusError)
        if is_error and self._error is None:
            self._error = outcome
        self._taken.append(outcome)
        if not (is_error and is_down(outcome)):
            self._has_answered = True
        elif not self._has_answered:
            self._taken += [outcome] * (len(self._requests) - len(self._taken))
        if len(self._taken) == len(self._requests):
            self._go_on()
        self._advance()

    def _advance(self) -> None:
        """Set the next request: each poll begins where the one before it was not answered."""
        taken, requests = len(self._taken), self._requests
        over = taken == len(requests)
        self.next_request = None if over else requests[(self._first + taken) % len(requests)]

    def _go_on(self) -> None:
        """Search for what was refused, or end the poll."""
        # The first request was not the first one of the plan.
        first = len(self._taken) - self._first % len(self._taken)
        taken = self._taken[first:] + self._taken[:first]
        if self._steps is None:
            self._answers = taken
            if not any(map(is_refusal, taken)):
                return
            self._holes = self._holes or Holes()
            self._new_steps(self._holes)
        assert self._steps is not None
        try:
            self._requests, self._taken = self._steps.send(taken), []
        except StopIteration as done:
            self._answers = done.value
            if self._error is None:
                self._error = next(filter(None, map(_error_of, self._answers)), None)

    def conclude(self, now: float) -> None:
        """End a poll: set the state of the device, its error and its rest."""
        self.error = self._error
        self.misses = 0 if self._has_answered else self.misses + 1
        if self.misses:
            # The device may be silent about this request only, so that another one comes first.
            self._first += 1
        self.state = DeviceState.DOWN if self.misses else DeviceState.UP
        self.rest_until = now + self.config.spacing
        self._steps = None

    def readings(self, time: float, first: int = 0) -> list[Reading]:
        """
        Return the readings of the poll.

        Args:
            time: when it was completed, in seconds since the epoch.
            first: the id of the first reading; the others have the next ones. 0 for no ids.
        """
        device, names, units = self.name, self.reads.names, self.reads.units
        labels = self.config.labels or NO_LABELS
        found = self._plan.results(self._answers, return_exceptions=True)
        values = list(found.values())
        if self._pace is not None:
            values = [found.get(name) for name in names]
        self._answers = []
        doubtful, fell = self._totals.take(values)
        if self._pace is not None:
            lost = {at for at, value in enumerate(values) if _is_lost(value)}
            self._pace.done(lost | doubtful)
        for at in doubtful:
            values[at] = self._totals.before(at)
        told = self._changes.pick(values, self._due)
        if doubtful:
            told = [at for at in told if at not in doubtful]
        readings = []
        for number, at in enumerate(told, first):
            value, quality, reason = judged(values[at])
            if at in fell:
                reason = "Fell"
            name, unit, key = names[at], units[at], number if first else 0
            readings.append(Reading(time, device, name, value, unit, quality, reason, key, labels))
        return readings

    def withdrawn(self, time: float, still_read: Collection[str] = ()) -> list[Reading]:
        """Return readings that take back those that were reported, without the points named."""
        if self.state is DeviceState.NEW:
            return []
        units = zip(self.reads.names, self.reads.units, strict=True)
        return offline(self.config, [each for each in units if each[0] not in still_read], time)

    def forget(self) -> None:
        """Forget the state of the device, and what was reported of it."""
        self.state = self.told_state = DeviceState.NEW
        self.since = 0.0
        self.error = None
        self._changes = _changes(self.config, self.reads)
        self._totals = _totals(self.config, self.reads)

    @property
    def pause(self) -> float:
        """Seconds that the device rests after a poll without an answer."""
        return rest_after(self.misses, self.interval, LONGEST_REST)

    @property
    def is_refused(self) -> bool:
        """True if the device answered, but refused a request."""
        return self.state is DeviceState.UP and self.error is not None


def _is_lost(value: object) -> bool:
    """Return True if there is an error in place of a value that the next poll may have."""
    return isinstance(value, ModbusError) and is_down(value)


def _error_of(answer: Any) -> ModbusError | None:
    """Return why an answer, or a part of it, is missing."""
    if isinstance(answer, PartialAnswer):
        return next(iter(answer.errors.values()), None)
    return answer if isinstance(answer, ModbusError) else None


def _changes(config: DeviceConfig, reads: Reads) -> Changes:
    bands = config.dead_bands
    return Changes(config.on_change, [bands.get(name) for name in reads.names])


def _totals(config: DeviceConfig, reads: Reads) -> Totals:
    return Totals(at for at, name in enumerate(reads.names) if config.map[name].never_falls)


def offline(device: DeviceConfig, points: Iterable[tuple[str, str]], time: float) -> list[Reading]:
    """Return readings that take back points of a device, given by their names and units."""
    labels = device.labels or NO_LABELS
    return [
        Reading(time, device.name, name, None, unit, "offline", "", 0, labels)
        for name, unit in points
    ]
