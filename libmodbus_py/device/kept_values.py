"""
The values of a device that a file keeps.
"""

from __future__ import annotations

import hashlib
from array import array
from collections.abc import Iterable
from typing import Any

from ..maps.point import Point
from ..protocol.tables import TABLES
from .access import Access
from .device import Device
from .point_index import PointIndex, RuledCells
from .state_lines import FILE, Run, UnitValues
from .written import FirstValues, changes

__all__ = ["KeptValues"]


class KeptValues:
    """The values of one device, for a file."""

    def __init__(self, device: Device) -> None:
        self._device = device

    def has(self, run: Run) -> bool:
        """Return True if the device has all cells of a run."""
        if run.table == FILE:
            file = self._device.files.get(run.file)
            return file is not None and file.has(run.address, len(run.values))
        table = getattr(self._device.mapping, run.table)
        return bool(table.has(run.address, len(run.values)))

    def meaning(self, name: str) -> list[Any] | None:
        """Return what the cells of a point mean; None if there is no such point."""
        point = self._device.points.get(name)
        return None if point is None else _meaning(point)

    def put(self, run: Run) -> None:
        """Set values, which the device has."""
        if run.table == FILE:
            with self._device.mapping:
                self._device.files[run.file].write(run.address, tuple(run.values))
        else:
            table = getattr(self._device.mapping, run.table)
            table[run.address : run.address + len(run.values)] = run.values

    def fingerprint(self) -> bytes:
        """Return a digest, which is another one when any value has changed."""
        found = hashlib.blake2b(digest_size=16, usedforsecurity=False)
        with self._device.mapping as mapping:
            for table in TABLES:
                found.update(getattr(mapping, table).view)
            for file in self._device.files.values():
                found.update(file.view)
        return found.digest()

    def written(self, first: Iterable[FirstValues]) -> UnitValues:
        """
        Return the values of one moment that are not the first ones.

        Args:
            first: the first values that are not 0, and those that the device computes.
        """
        by_place: dict[tuple[str, int], list[FirstValues]] = {}
        for each in first:
            by_place.setdefault((each.table, each.file), []).append(each)
        runs = [
            run
            for table, file, start, cells in self._snapshot()
            for run in changes(table, file, start, cells, by_place.get((table, file), ()))
        ]
        return UnitValues(self._points(runs), runs)

    def _snapshot(self) -> list[tuple[str, int, int, array[int]]]:
        with self._device.mapping as mapping:
            files = [
                (FILE, number, 0, array("H", bytes(file.view)))
                for number, file in self._device.files.items()
            ]
            return [*mapping._snapshot(), *files]

    def _points(self, runs: Iterable[Run]) -> dict[str, list[Any]]:
        index = PointIndex(map(RuledCells.of, self._device.points.values()))
        found = {
            point.name: _meaning(point)
            for run in runs
            for point in index.touched(
                Access(run.table, run.address, len(run.values), file=run.file)
            )
        }
        return {name: found[name] for name in sorted(found)}


def _meaning(point: Point) -> list[Any]:
    """Return what the cells of a point mean, apart from scale, bounds and texts."""
    return [point.table, point.address, point.count, point.type, point.order]
