"""
The points of a map from poll to poll: which are due, and totals that are read again; and the pace
of the polls of a client.

No clock: times are seconds of any steady clock.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Generator, Iterable, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

from ..protocol.errors import ModbusError
from .items import NamedValues, PlanOptions
from .meaning import NoValue
from .refusals import is_refusal

if TYPE_CHECKING:
    from typing import Unpack

    from .plan import Plan
    from .point_plan import PointPlan
    from .register_map import RegisterMap

TOLERANCE = 0.001
"""The part of the time between two polls that sums of times may be inexact by."""

MOST_PLANS = 64
"""Plans for different sets of points that are kept."""


class PointIntervals:
    """
    The intervals of the points of one device, from poll to poll.

    Polls come at the shortest interval. A point with a longer one is read at the first poll that is
    due when its interval is over, and never sooner. The times at which polls are due count, not
    those at which they begin, so that no poll is left out because the one before began late.
    """

    __slots__ = ("_again", "_at", "_due", "_indexes", "_last", "interval")

    def __init__(self, own: Sequence[float | None], usual: float) -> None:
        self._indexes: dict[float, list[int]] = {}
        for at, interval in enumerate(own):
            self._indexes.setdefault(usual if interval is None else interval, []).append(at)
        self.interval: float = min(self._indexes, default=usual)
        # When the poll was due that read the points of an interval last.
        self._last: dict[float, float] = {}
        # Intervals whose points were not answered at the last poll, although others were.
        self._again: set[float] = set()
        self._due: list[float] = []
        self._at = 0.0

    def due(self, at: float) -> tuple[int, ...] | None:
        """Return the indexes of the points that are read at a poll at this time; None for all."""
        self._at = at
        over = at + self.interval * TOLERANCE
        self._due = [
            own
            for own in self._indexes
            if own == self.interval or self._last.get(own, -math.inf) + own <= over
        ]
        if len(self._due) == len(self._indexes):
            return None
        return tuple(sorted(at for own in self._due for at in self._indexes[own]))

    def done(self, unanswered: Collection[int] = ()) -> None:
        """Note what was read: the unanswered are due once more, or until anything is answered."""
        missing = set(unanswered)
        if missing and all(missing.issuperset(self._indexes[own]) for own in self._due):
            return
        for own in self._due:
            if own not in self._again and not missing.isdisjoint(self._indexes[own]):
                self._again.add(own)
                continue
            self._again.discard(own)
            self._last[own] = self._at


class Totals:
    """Remembers the totals of one device from poll to poll. No clock."""

    __slots__ = ("_doubtful", "_last")

    def __init__(self, indexes: Iterable[int]) -> None:
        self._last: dict[int, Any] = dict.fromkeys(indexes)
        self._doubtful: frozenset[int] = frozenset()

    def take(self, values: Sequence[Any]) -> tuple[frozenset[int], frozenset[int]]:
        """Return which totals are smaller than before: doubtful at first, fell when read again."""
        if not self._last:
            return frozenset(), frozenset()
        smaller = {
            at
            for at, before in self._last.items()
            if before is not None and isinstance(values[at], int | float) and values[at] < before
        }
        fell = frozenset(smaller & self._doubtful)
        doubtful = frozenset(smaller - fell)
        for at in self._last.keys() - doubtful:
            if isinstance(values[at], int | float):
                self._last[at] = values[at]
        unread = {at for at in self._doubtful if not isinstance(values[at], int | float)}
        self._doubtful = doubtful | unread
        return doubtful, fell


class PartialPlans:
    """The plan of points of a map, with their names, and plans of some of them, which are kept."""

    def __init__(
        self, map: RegisterMap, names: Iterable[str] | None, **options: Unpack[PlanOptions]
    ) -> None:
        self.plan: PointPlan = map.plan(names, **options)
        self.names: tuple[str, ...] = self.plan.names
        self._map, self._options = map, options
        self._parts: dict[tuple[int, ...], PointPlan] = {}

    def plan_of(self, indexes: tuple[int, ...] | None) -> PointPlan:
        """Return the plan of the points with some indexes; None for all."""
        if indexes is None:
            return self.plan
        if indexes not in self._parts:
            if len(self._parts) == MOST_PLANS:
                self._parts.clear()
            names = [self.names[at] for at in indexes]
            self._parts[indexes] = self._map.plan(names, **self._options)
        return self._parts[indexes]


class PolledValues(NamedValues[str, Any]):
    """
    The values of a poll by name.

    Attributes:
        fell: the names of totals (`Point.never_falls`) that are smaller than before, even when
            they were read a second time.
    """

    fell: frozenset[str] = frozenset()


class WatchedPoints(PartialPlans):
    """
    Decides what is read at each poll of a map, and keeps the values of points that are not due.

    Points without an interval are read `every` seconds; `interval` is the shortest of all.
    """

    def __init__(
        self,
        map: RegisterMap,
        names: Iterable[str] | None,
        every: float,
        **options: Unpack[PlanOptions],
    ) -> None:
        super().__init__(map, names, **options)
        points = [map[name] for name in self.names]
        self._pace = PointIntervals([point.interval for point in points], every)
        self._totals = Totals(at for at, point in enumerate(points) if point.never_falls)
        self._values: dict[str, Any] = {}
        self.interval: float = self._pace.interval

    def poll(self, at: float) -> Generator[PointPlan, dict[str, Any], PolledValues]:
        """Yield the plans of points that are due, receive their results, return all values."""
        results = yield self.plan_of(self._pace.due(at))
        doubtful, fell = self._totals.take([*map(results.get, self.names)])
        if doubtful:
            again = yield self.plan_of(tuple(sorted(doubtful)))
            results |= again
            _, fell = self._totals.take([*map(again.get, self.names)])
        self._pace.done([at for at, name in enumerate(self.names) if _is_lost(results.get(name))])
        self._values |= results
        values = PolledValues({name: self._values[name] for name in self.names})
        values.fell = frozenset(self.names[at] for at in fell)
        return values


def _is_lost(value: object) -> bool:
    """Return True if there is an error in place of a value that the next poll may have."""
    is_answer = is_refusal(value) or isinstance(value, NoValue)
    return isinstance(value, ModbusError) and not is_answer


# --- plans of watches -----------------------------------------------------------------------


class Pace:
    """
    When each poll is due, in seconds of any steady clock.

    The n-th poll is due n intervals after the first one, so that the times do not drift. A poll
    that is late, because the device or the program took longer, is left out.
    """

    def __init__(self, interval: float) -> None:
        self._interval = interval
        self._begun: float | None = None  # when the first poll began
        self._polls = 0

    def due(self, now: float) -> float:
        """Return when the next poll is due."""
        if self._begun is None:
            return now
        first_not_missed = math.ceil((now - self._begun) / self._interval)
        return self._begun + max(self._polls, first_not_missed) * self._interval

    def begin(self, due: float) -> None:
        """Note that the poll that was due at this time begins."""
        if self._begun is None:
            self._begun = due
        self._polls = round((due - self._begun) / self._interval) + 1


def watched(what: Any, names: Any, every: float, options: Any) -> WatchedPoints | Plan:
    """Return what is polled; raise TypeError or ValueError as `RegisterMap.plan` and `Plan` do."""
    from .plan import planned
    from .register_map import RegisterMap, map_of

    if isinstance(what, RegisterMap | str | PathLike):
        return WatchedPoints(map_of(what), names, every, **options)
    if names is not None:
        raise ValueError("names are for a RegisterMap only")
    return planned(what, options)


def polled(plan: Plan, answers: list[Any]) -> Any:
    """Return the values of a poll, with the reason in place of a value that could not be read."""
    from .point_plan import PointPlan

    if isinstance(plan, PointPlan):
        return plan.results(answers, return_exceptions=True)
    return plan.results(answers)
