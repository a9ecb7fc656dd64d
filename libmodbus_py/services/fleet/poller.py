"""
One device while it is polled: the requests of a poll, the state of the device, and its readings.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Iterable, Sequence
from enum import Enum
from typing import Any

from ...maps.holes import Holes, PartialAnswer, Unreadable, is_refusal, reading
from ...maps.plan import unreadable_of
from ...maps.point_plan import PointPlan
from ...maps.watched import PointIntervals, Totals
from ...protocol.errors import ModbusError
from ..line import LineRequest, rest_after
from .config import DeviceConfig
from .readings import NO_LABELS, Changes, Reading, classified, is_down

__all__ = ["DeviceState", "OnePoll", "Poller", "Reads", "offline"]

LONGEST_REST_S = 60.0
"""The time between two trials of a device that does not answer, unless its interval is longer."""


MOST_PLANS = 64
"""Plans for different sets of points of a kind of device that are kept."""


class DeviceState(Enum):
    """The state of a device."""

    NEW = "new"
    UP = "up"
    DOWN = "down"


class Reads:
    """The requests and points of a kind of device; thousands of devices share one object."""

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


class OnePoll:
    """
    One poll of a device: requests, each after the outcome of the one before, and the values.

    The poll ends if its first request is not answered. If the device refuses a request, the poll
    goes on until it is known which points are refused.

    Args:
        holes: what the device refused in earlier polls; None for nothing.
        first: the index of the request that is asked first.
        now: the time in seconds, of any steady clock.
        connects: how many connections the client of the device has made.

    Attributes:
        request: the next request; None when the poll is over.
        error: the first error; None if all requests, and parts of them, were answered.
        is_answered: True if the device answered, even if it refused.
        holes: what the device refuses, as far as it is known.
        news: sentences about points that the device was found to refuse.
    """

    __slots__ = (
        *("_answers", "_first", "_plan", "_requests", "_steps", "_outcomes", "_time"),
        *("error", "holes", "is_answered", "news", "request"),
    )

    def __init__(
        self,
        plan: PointPlan,
        holes: Holes | None = None,
        *,
        first: int = 0,
        now: float = 0.0,
        connects: int = 1,
    ) -> None:
        self.error: ModbusError | None = None
        self.is_answered: bool = False
        self.holes: Holes | None = holes
        self.news: list[str] = []
        self._plan = plan
        self._first = first
        self._time = now, connects
        self._answers: list[Any] = []
        self._outcomes: list[Any] = []
        self._steps: Generator[Any, Any, list[Any]] | None = None
        self._requests: Sequence[Any] = plan.requests
        if holes:
            self._requests = self._new_steps(holes)
        self._advance()

    def take(self, outcome: Any) -> None:
        """Take the response to the request, or its error."""
        is_error = isinstance(outcome, ModbusError)
        if is_error and self.error is None:
            self.error = outcome
        self._outcomes.append(outcome)
        if not (is_error and is_down(outcome)):
            self.is_answered = True
        elif not self.is_answered:
            self._outcomes += [outcome] * (len(self._requests) - len(self._outcomes))
        if len(self._outcomes) == len(self._requests):
            self._go_on()
        self._advance()

    def values(self) -> dict[str, Any]:
        """Return the values by the names of the points, with errors in place of missing ones."""
        found: dict[str, Any] = self._plan.results(self._answers, return_exceptions=True)
        return found

    def _advance(self) -> None:
        done, requests = len(self._outcomes), self._requests
        is_over = done == len(requests)
        self.request: Any = None if is_over else requests[(self._first + done) % len(requests)]

    def _new_steps(self, holes: Holes) -> Sequence[Any]:
        """Begin to leave out what is refused; return the first requests."""
        self._steps = reading(self._plan.blocks, holes, *self._time, tell=self.news.append)
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
            self.holes = self.holes or Holes()
            self._new_steps(self.holes)
        assert self._steps is not None
        try:
            self._requests, self._outcomes = self._steps.send(outcomes), []
        except StopIteration as done:
            self._answers = done.value
            if self.error is None:
                self.error = next(filter(None, map(_error_of, self._answers)), None)


class Poller(LineRequest):
    """
    A device of a fleet: its current poll, its state, and what was reported of it.

    Attributes:
        request: of the current poll; None when no poll is under way.
        state: NEW until its first poll is over.
        error: the first error of the last poll, or that of a point that was left out; None if all
            points were read.
        at: when the device is polled next, or was polled last.
        misses: polls in a row without an answer.
        answered_at: when the last poll that was answered was over, in seconds since the epoch; 0
            before.
        since: since when the device is up or down, in seconds since the epoch; 0 if NEW.
        rest_until: when the next request may be sent to the device.
        news: sentences about points that the device was found to refuse, until they are logged.
    """

    __slots__ = (
        *("_changes", "_due", "_first", "_holes", "_pace", "_poll", "_totals"),
        *("answered_at", "at", "config", "error", "name", "news", "reads", "rest_until"),
        *("since", "state"),
    )

    def __init__(self, config: DeviceConfig, reads: Reads) -> None:
        super().__init__(config.unit)
        self.config: DeviceConfig = config
        self.name: str = config.name
        self.reads: Reads = reads
        self.at: float = 0.0
        self.answered_at: float = 0.0
        self.rest_until: float = 0.0
        self.news: list[str] = []
        self._pace = reads.pace(config.interval)
        self._due: tuple[int, ...] | None = None
        self._poll: OnePoll | None = None
        self._holes: Holes | None = None
        self._first = 0
        self.forget()

    def forget(self) -> None:
        """Forget the state of the device, and what was reported of it."""
        self.state: DeviceState = DeviceState.NEW
        self.since: float = 0.0
        self.error: Exception | None = None
        names, config = self.reads.names, self.config
        self._changes = Changes(config.on_change, [config.dead_bands.get(each) for each in names])
        self._totals = Totals(at for at, each in enumerate(names) if config.map[each].never_falls)

    @property
    def interval(self) -> float:
        """Seconds from one poll to the next."""
        return self.config.interval if self._pace is None else self._pace.interval

    @property
    def pause(self) -> float:
        """Seconds that the device rests after a poll without an answer."""
        return rest_after(self.misses, self.interval, LONGEST_REST_S)

    @property
    def is_refused(self) -> bool:
        """True if the device answered, but refused a request."""
        return self.state is DeviceState.UP and self.error is not None

    @property
    def unreadable(self) -> list[Unreadable]:
        """The points that the device refuses, and that are left out until they are tried again."""
        if self._holes is None:
            return []
        device = f"{self.config.endpoint}, unit {self.config.unit}"
        return unreadable_of(self.reads.plan, self._holes, device)

    def begin(self, planned: float = 0.0, connects: int = 1) -> None:
        """Begin a poll that is due at `planned`; the client has made so many connections."""
        self.waits_since = planned
        if self._pace is not None:
            self._due = self._pace.due(planned)
        plan = self.reads.plan_of(self._due)
        self._poll = OnePoll(plan, self._holes, first=self._first, now=planned, connects=connects)
        self.request: Any = self._poll.request

    def take(self, outcome: Any, now: float) -> None:
        """Take the outcome of the request; with the last one, the state of the device changes."""
        poll = self._poll
        assert poll is not None
        poll.take(outcome)
        self.request = poll.request
        self.rest_until = now + self.config.spacing
        if poll.request is not None:
            return
        self._holes = poll.holes
        self.news += poll.news
        self.error = poll.error
        self.misses: int = 0 if poll.is_answered else self.misses + 1
        if self.misses:
            # The device may be silent about this request only, so that another one comes first.
            self._first += 1
        self.state = DeviceState.DOWN if self.misses else DeviceState.UP

    def readings(self, time: float, first: int = 0) -> list[Reading]:
        """Return the readings of the poll that is over, with ids from `first` on; 0 for no ids."""
        poll, self._poll = self._poll, None
        assert poll is not None
        names, units = self.reads.names, self.reads.units
        found = poll.values()
        values = list(found.values()) if self._pace is None else [*map(found.get, names)]
        doubtful, fell = self._totals.take(values)
        if self._pace is not None:
            lost = {
                at
                for at, value in enumerate(values)
                if isinstance(value, ModbusError) and is_down(value)
            }
            self._pace.done(lost | doubtful)
        for at in doubtful:
            values[at] = self._totals.before(at)
        reported = self._changes.pick(values, self._due)
        if doubtful:
            reported = [at for at in reported if at not in doubtful]
        device, labels, readings = self.name, self.config.labels or NO_LABELS, []
        for number, at in enumerate(reported, first):
            value, quality, reason = classified(values[at])
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


def _error_of(answer: Any) -> ModbusError | None:
    """Return why an answer, or a part of it, is missing."""
    if isinstance(answer, PartialAnswer):
        return next(iter(answer.errors.values()), None)
    return answer if isinstance(answer, ModbusError) else None


def offline(device: DeviceConfig, points: Iterable[tuple[str, str]], time: float) -> list[Reading]:
    """Return readings that take back points of a device, given by their names and units."""
    labels = device.labels or NO_LABELS
    return [
        Reading(time, device.name, name, None, unit, "offline", "", 0, labels)
        for name, unit in points
    ]
