"""
The clockwork of a device: moving values are computed from the time since the start when read.

So an idle simulator takes no processor time.
"""

from __future__ import annotations

import math
import random
import time
from bisect import bisect_right
from collections.abc import Callable, Iterable
from typing import Any

from ...device.mapping import Mapping
from ...protocol.errors import ServerDeviceFailure
from ...protocol.tables import TABLES
from .simulated_point import Compute, SimulatedPoint, fitting

__all__ = ["Clockwork"]


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

    def values(self, point: SimulatedPoint, indices: range, now: float) -> list[Any]:
        """Return some values of a point, at a time since the start."""
        self._refresh(point, indices, now)
        width = point.size
        cells = list(map(int, self._table(point)[point.slice_of(indices)]))
        if indices.step > 1:
            starts = range(0, len(cells), width * indices.step)
            cells = [cell for start in starts for cell in cells[start : start + width]]
        try:
            found = point.point.values_in(cells)
        except ValueError as error:
            raise ServerDeviceFailure(str(error)) from None
        # A copy of no value is computed with, like a nan.
        return [math.nan if value is None else value for value in found]

    def _refresh(self, point: SimulatedPoint, indices: range, now: float) -> None:
        key = point.table, point.first
        compute = self._moving.get(key)
        if compute is None or key in self._held:
            return
        table = self._table(point)
        values = [fitting(point.point, value) for value in compute(indices, now)]
        if indices.step == 1:
            table[point.slice_of(indices)] = point.point.cells_for(values)
        else:
            for index, value in zip(indices, values, strict=True):
                table[point.slice_of(range(index, index + 1))] = point.point.cells_for([value])

    def _table(self, point: SimulatedPoint) -> Any:
        return getattr(self._mapping, point.table)
