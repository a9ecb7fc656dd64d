"""
The points of a map from poll to poll: which are due, and totals that are read again.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable
from typing import Any, Unpack

from ..protocol.errors import ModbusError
from .holes import is_refusal
from .pace import PointIntervals
from .plan import PlanOptions
from .register_map import PointPlan, RegisterMap
from .totals import Totals

__all__ = ["PolledValues", "WatchedPoints"]

MOST_PLANS = 64
"""Plans for different sets of points that are kept."""


class PolledValues(dict[str, Any]):
    """
    The values of a poll by name.

    Attributes:
        fell: the names of totals (`Point.never_falls`) that are smaller than before, even when
            they were read a second time.
    """

    fell: frozenset[str] = frozenset()


class WatchedPoints:
    """
    Decides what is read at each poll of a map, and keeps the values of points that are not due.

    Args:
        map: the map.
        names: of its points; None for all that can be read.
        every: seconds between two reads of points without an interval.
        options: of `Plan`.

    Attributes:
        interval: seconds from one poll to the next: `every`, or the shortest interval.

    Raises:
        TypeError, ValueError: as `RegisterMap.plan`.
    """

    def __init__(
        self,
        map: RegisterMap,
        names: Iterable[str] | None,
        every: float,
        **options: Unpack[PlanOptions],
    ) -> None:
        wanted = None if names is None or isinstance(names, str) else list(names)
        plan = map.plan(names if wanted is None else wanted, **options)
        self._map, self._options = map, options
        self._names = plan.names
        self._plans: dict[tuple[int, ...] | None, PointPlan] = {None: plan}
        points = [map[name] for name in self._names]
        self._pace = PointIntervals([point.interval for point in points], every)
        self._totals = Totals(at for at, point in enumerate(points) if point.never_falls)
        self._values: dict[str, Any] = {}
        self.interval: float = self._pace.interval

    def poll(self, at: float) -> Generator[PointPlan, dict[str, Any], PolledValues]:
        """
        Yield the plans of a poll, take their results, and return all values.

        Args:
            at: when the poll is due, in seconds of any steady clock.
        """
        found = yield self._plan(self._pace.due(at))
        fell: frozenset[int] = frozenset()
        doubtful = self._totals.take(self._all(found)).doubtful
        if doubtful:
            again = yield self._plan(tuple(sorted(doubtful)))
            found |= again
            fell = self._totals.take(self._all(again)).fell
        self._pace.done([at for at, name in enumerate(self._names) if _is_lost(found.get(name))])
        self._values |= found
        values = PolledValues({name: self._values[name] for name in self._names})
        values.fell = frozenset(self._names[at] for at in fell)
        return values

    def _all(self, found: dict[str, Any]) -> list[Any]:
        return [found.get(name) for name in self._names]

    def _plan(self, indexes: tuple[int, ...] | None) -> PointPlan:
        if indexes not in self._plans:
            if len(self._plans) == MOST_PLANS:
                self._plans = {None: self._plans[None]}
            assert indexes is not None
            names = [self._names[at] for at in indexes]
            self._plans[indexes] = self._map.plan(names, **self._options)
        return self._plans[indexes]


def _is_lost(value: object) -> bool:
    """Return True if there is an error in place of a value that the next poll may have."""
    return isinstance(value, ModbusError) and not is_refusal(value)
