"""
The points of simulated devices, and the clockwork that computes those that move.

A moving value is computed from the time since the start when it is read, so an idle simulator takes
no processor time.
"""

from __future__ import annotations

import math
import random
import time
from array import array
from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

from ...device.mapping import Mapping
from ...maps.point import Point, Rights
from ...protocol.errors import ServerDeviceFailure
from ...protocol.mistakes import Path
from ...protocol.tables import TABLES

__all__ = ["Behaviour", "Clockwork", "Compute", "SimulatedPoint"]

Compute = Callable[[Sequence[int], float], list[Any]]
"""Function that returns the values with these indices in a point, at seconds since the start."""


class Behaviour(Protocol):
    """The movement of a point's values. TypeError, ValueError: an attribute is wrong."""

    def begin(self, point: SimulatedPoint, others: Clockwork) -> Compute:
        """
        Return the function that computes the values of a point.

        Args:
            others: the points of the device, which the point may follow.

        Raises:
            ValueError: the values of the point cannot move this way.
        """
        ...


@dataclass(frozen=True)
class SimulatedPoint:
    """
    A point of a simulated device, or some records of a file.

    Attributes:
        path: path of the point in the device file.
        point: its location, and the meaning of its cells. For records its table has no meaning,
            and its address is the number of the first record.
        cells: its initial cells; those of one value if all values are the same.
        behaviour: how its values move; None if they do not.
        moved_by: path of the behaviour in the device file.
        file: the number of the file that contains these records; 0 for a table.
        is_named: True if the point has its own name, False if it is named after its table.
        is_mapped: True if it comes from a register map.
    """

    path: Path
    point: Point
    cells: array[int]
    behaviour: Behaviour | None = None
    moved_by: Path = ()
    file: int = 0
    is_named: bool = False
    is_mapped: bool = False

    @cached_property
    def table(self) -> str:
        """Its table, or "file"."""
        return "file" if self.file else self.point.table

    @cached_property
    def first(self) -> int:
        """The address where its first value begins."""
        return self.point.address

    @cached_property
    def stop(self) -> int:
        """The address after the last value."""
        return self.point.cells.stop

    @cached_property
    def size(self) -> int:
        """The cells of one value."""
        return self.point.read.size

    @property
    def access(self) -> Rights | None:
        """The access that clients have: "read", "write" or "read_write"."""
        # A moving value written by a client would be lost at the next read.
        return "read" if self.behaviour else self.point.access

    @property
    def area(self) -> tuple[str, int]:
        """Its table, or "file", and the number of the file."""
        return self.table, self.file

    @property
    def all_cells(self) -> array[int]:
        """The initial content of all its cells."""
        return self.cells * (len(self.point.cells) // len(self.cells))

    @property
    def identity(self) -> tuple[object, ...]:
        """The key by which points compare equal that have the same meaning and initial values."""
        point = self.point
        scale = (point.scale, point.offset, point.scale_from, point.scale_as)
        names = (point.missing, point.bit, point.byte, str(point.states), str(point.bits))
        meaning = (point.type, point.order, point.time_zone, *scale, *names)
        moves = type(self.behaviour).__name__
        return (*self.area, self.first, self.stop, meaning, moves, self.cells.tobytes())

    def slice_of(self, first: int, last: int) -> slice:
        """Return the addresses from one value to another, both by their indices."""
        return slice(self.first + first * self.size, self.first + (last + 1) * self.size)


class Clockwork:
    """
    Keeps the moving values of a mapping up to date, as far as they are read.

    Args:
        mapping: the mapping that contains the values.
        points: all points of the mapping; they do not overlap.
        clock: returns seconds; the time of the call is the start.

    Attributes:
        seed: the seed of random moves without a seed of their own.
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
        self.seed: int = random.getrandbits(64)
        self._points: dict[str, list[SimulatedPoint]] = {table: [] for table in TABLES}
        for point in sorted(points, key=lambda point: point.first):
            self._points[point.table].append(point)
        self._moving: dict[tuple[str, int], Compute] = {}
        self._held: set[tuple[str, int]] = set()

    def start(self, point: SimulatedPoint) -> None:
        """
        Start the behaviour of a point, if it has one.

        Raises:
            ValueError: the behaviour does not suit the values of the point.
        """
        if point.behaviour is not None:
            self._moving[point.table, point.first] = point.behaviour.begin(point, self)

    def go_on_from(self, before: Clockwork) -> None:
        """Continue with the start, the seed and the held values of another clockwork."""
        self._start, self.seed = before._start, before.seed
        self._held = before._held & self._moving.keys()

    def find(self, table: str, address: int) -> SimulatedPoint | None:
        """Return the point that has an address."""
        points = self._points[table]
        at = bisect_right(points, address, key=lambda point: point.first) - 1
        return points[at] if at >= 0 and address < points[at].stop else None

    def moves(self, table: str, cells: range) -> bool:
        """Return True if a value moves that has some of these cells, and is not held."""
        return any(each not in self._held for each in self._with(table, cells))

    def holds(self, table: str, cells: range) -> bool:
        """Return True if all moving values that have some of these cells are held."""
        found = self._with(table, cells)
        return bool(found) and self._held.issuperset(found)

    def hold(self, table: str, cells: range, *, is_on: bool) -> None:
        """Hold the moving values that have some of these cells, or let them move again."""
        if is_on:
            self._held.update(self._with(table, cells))
        else:
            self._held.difference_update(self._with(table, cells))

    def _with(self, table: str, cells: range) -> list[tuple[str, int]]:
        """Return the keys of the moving points that have some of these cells."""
        return [
            (table, each.first)
            for each in self._points[table]
            if each.first < cells.stop and cells.start < each.stop and each.behaviour is not None
        ]

    def refresh(self, table: str, address: int, count: int) -> None:
        """
        Compute the values that are about to be read.

        Raises:
            ServerDeviceFailure: the source of a copy contains no value of its type.
        """
        if not self._moving:
            return
        now = self._clock() - self._start
        stop = address + count
        points = self._points[table]
        at = max(bisect_right(points, address, key=lambda point: point.first) - 1, 0)
        while at < len(points) and points[at].first < stop:
            point = points[at]
            first = max(address - point.first, 0) // point.size
            last = (min(stop, point.stop) - point.first - 1) // point.size
            self._refresh(point, range(first, last + 1), now)
            at += 1

    def values(self, point: SimulatedPoint, indices: Sequence[int], now: float) -> list[Any]:
        """Return some values of a point, at a time since the start."""
        self._refresh(point, indices, now)
        cells: list[int] = []
        for first, last in _runs(indices):
            cells += map(int, self._table(point)[point.slice_of(first, last)])
        try:
            found = point.point.values_in(cells)
        except ValueError as error:
            raise ServerDeviceFailure(str(error)) from None
        # A copy of no value is computed with, like a nan.
        return [math.nan if value is None else value for value in found]

    def _refresh(self, point: SimulatedPoint, indices: Sequence[int], now: float) -> None:
        key = point.table, point.first
        compute = self._moving.get(key)
        if compute is None or key in self._held:
            return
        values = [_fitting(point.point, value) for value in compute(indices, now)]
        for first, last in _runs(indices):
            count = last - first + 1
            self._table(point)[point.slice_of(first, last)] = point.point.cells_for(values[:count])
            del values[:count]

    def _table(self, point: SimulatedPoint) -> Any:
        return getattr(self._mapping, point.table)


def _runs(indices: Sequence[int]) -> list[tuple[int, int]]:
    """Return the first and the last of each run of indices that follow each other."""
    if indices[-1] - indices[0] == len(indices) - 1:
        return [(indices[0], indices[-1])]
    return [(index, index) for index in indices]


def _fitting(point: Point, value: Any) -> Any:
    """Return the value of a point that is nearest to a number; 0 for nan."""
    low, high = point.limits
    if low is None or high is None:
        return value
    if value != value:  # nan; math.isnan cannot take the largest integers
        return 0
    nearest = min(max(value, low), high)
    is_scaled = (point.scale, point.offset) != (1, 0)
    return round(nearest) if point.step and not is_scaled else nearest
