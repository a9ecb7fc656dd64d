"""
The points of simulated devices, and the clockwork that computes those that move.

A moving value is computed from the time since the start when it is read, so an idle simulator takes
no processor time.
"""

from __future__ import annotations

import math
import random
import time
from bisect import bisect_right
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol

from ...device.mapping import Mapping
from ...maps.point import Point
from ...protocol.errors import ServerDeviceFailure
from ...protocol.mistakes import Path, WrongValue, inside
from ...protocol.tables import TABLES

__all__ = ["Behaviour", "Clockwork", "Compute", "SimulatedPoint"]

Compute = Callable[[int, float], Any]
"""Function that returns the value with this index in a point, at seconds since the start."""


class Behaviour(Protocol):
    """The movement of a point's values. TypeError, ValueError: an attribute is wrong."""

    def begin(self, point: SimulatedPoint, others: Clockwork) -> Compute:
        """Return what computes a point's values; raise ValueError if they cannot move this way."""
        ...


@dataclass(frozen=True)
class SimulatedPoint:
    """A point of a simulated device, or some records of a file."""

    path: Path  # in the device file
    point: Point  # of records, its address is the first one, and its table has no meaning
    cells: tuple[int, ...] = ()  # at first; none if all are 0
    behaviour: Behaviour | None = None
    moved_by: Path = ()  # the path of the behaviour
    file: int = 0  # the number of the file that contains these records
    is_mapped: bool = False  # the point comes from a register map

    @property
    def table(self) -> str:
        """Its table, or "file"."""
        return "file" if self.file else self.point.table

    @property
    def area(self) -> tuple[str, int]:
        """Its table, or "file", and the number of the file."""
        return self.table, self.file

    @property
    def span(self) -> range:
        """The addresses of all its cells, or records."""
        return self.point.cells

    def slice_of(self, index: int) -> slice:
        """Return the addresses of one value."""
        first = self.span.start + index * self.point.read.size
        return slice(first, first + self.point.read.size)

    @property
    def identity(self) -> tuple[object, ...]:
        """The key by which points compare equal that have the same meaning and initial values."""
        point = self.point
        scale = (point.scale, point.offset, point.scale_from, point.scale_as)
        names = (point.missing, point.bit, point.byte, str(point.states), str(point.bits))
        meaning = (point.type, point.order, point.time_zone, *scale, *names)
        return (self.area, self.span, meaning, type(self.behaviour), self.cells)


class Clockwork:
    """
    Keeps the moving values of a mapping up to date, as far as they are read.

    Args:
        points: all points of the mapping.
        clock: returns seconds; the time of the call is the start.
    """

    def __init__(
        self,
        mapping: Mapping,
        points: Iterable[SimulatedPoint],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._mapping = mapping
        self._clock = clock
        self._start = clock()
        self.seed: int = random.getrandbits(64)  # of random moves without a seed of their own
        self._points: dict[str, list[SimulatedPoint]] = {table: [] for table in TABLES}
        for each in sorted(points, key=lambda each: each.span.start):
            self._points[each.table].append(each)
        self._moving: dict[tuple[str, range], tuple[SimulatedPoint, Compute]] = {}
        self._held: set[tuple[str, range]] = set()
        for each in [each for points in self._points.values() for each in points]:
            if each.behaviour is not None:
                with inside(*each.moved_by):
                    self._moving[each.table, each.span] = each, self._begun(each, each.behaviour)

    def _begun(self, each: SimulatedPoint, behaviour: Behaviour) -> Compute:
        if (source := each.point.scale_from) is not None:
            raise WrongValue.about((), f"a point that {source} scales does not move")
        return behaviour.begin(each, self)

    def go_on_from(self, before: Clockwork) -> None:
        """Continue with the start, the seed and the held values of another clockwork."""
        self._start, self.seed = before._start, before.seed
        self._held = before._held & self._moving.keys()

    def find(self, table: str, address: int) -> SimulatedPoint | None:
        """Return the point that has an address."""
        points = self._points[table]
        at = bisect_right(points, address, key=lambda each: each.span.start)
        return next((each for each in points[at - 1 :: -1] if at and address in each.span), None)

    # --- held values ---------------------------------------------------------------------------

    def _with(self, table: str, cells: range) -> set[tuple[str, range]]:
        """Return the keys of the moving points that have some of these cells."""
        return {
            (each_table, span)
            for each_table, span in self._moving
            if each_table == table and span.start < cells.stop and cells.start < span.stop
        }

    def moves(self, table: str, cells: range) -> bool:
        """Return True if a value moves that has some of these cells, and is not held."""
        return bool(self._with(table, cells) - self._held)

    def holds(self, table: str, cells: range) -> bool:
        """Return True if all moving values that have some of these cells are held."""
        found = self._with(table, cells)
        return bool(found) and found <= self._held

    def hold(self, table: str, cells: range, *, is_on: bool) -> None:
        """Hold the moving values that have some of these cells, or let them move again."""
        if is_on:
            self._held |= self._with(table, cells)
        else:
            self._held -= self._with(table, cells)

    # --- values --------------------------------------------------------------------------------

    def refresh(self, table: str, address: int, count: int) -> None:
        """
        Compute the values that are about to be read.

        Raises:
            ServerDeviceFailure: the source of a copy contains no value of its type.
        """
        now, stop = self._clock() - self._start, address + count
        for key in self._with(table, range(address, stop)):
            each, _ = self._moving[key]
            size, start = each.point.read.size, each.span.start
            first = max(address - start, 0) // size
            for index in range(first, (min(stop, each.span.stop) - start - 1) // size + 1):
                self._refresh(each, index, now)

    def value(self, each: SimulatedPoint, index: int, now: float) -> Any:
        """Return one value of a point, at a time since the start; nan for no value."""
        self._refresh(each, index, now)
        cells = getattr(self._mapping, each.table)[each.slice_of(index)]
        try:
            (found,) = each.point.values_in(list(map(int, cells)))
        except ValueError as error:
            raise ServerDeviceFailure(str(error)) from None
        return math.nan if found is None else found

    def _refresh(self, each: SimulatedPoint, index: int, now: float) -> None:
        key = each.table, each.span
        if key in self._moving and key not in self._held:
            value = _nearest(each.point, self._moving[key][1](index, now))
            table = getattr(self._mapping, each.table)
            table[each.slice_of(index)] = each.point.cells_for([value])


def _nearest(point: Point, value: Any) -> Any:
    """Return the value of a point that is nearest to a number; 0 for nan."""
    low, high = point.limits
    if low is None or high is None:
        return value
    if value != value:  # nan; math.isnan cannot take the largest integers
        return 0
    nearest = min(max(value, low), high)
    is_scaled = (point.scale, point.offset) != (1, 0)
    return round(nearest) if point.step and not is_scaled else nearest
