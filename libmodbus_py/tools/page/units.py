"""
The units of a server, with rows of their points and cells, as a page shows them.

Values that a device computes when they are read are computed for the page as for clients. Where the
device refuses, because clients may not read them, the page shows the cells as they are.
"""

from __future__ import annotations

import time
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from ...device.device import Device
from ...device.mapping import Table
from ...device.named_values import source_after
from ...maps.point import Point
from ...protocol.errors import ExceptionResponse
from ...protocol.logs import HarmlessLogger
from ...protocol.tables import TABLES
from ...server.units import SERVER_ITSELF
from ..faults.server import Server
from ..simulator.simulated import SimulatedDevice
from .samples import SPARK, Samples
from .text import judged_point

__all__ = [
    "SAMPLED",
    "ShownServer",
    "ShownUnit",
    "cell_rows",
    "point_rows",
    "shown_of",
]

logger: HarmlessLogger = HarmlessLogger(__name__)

# Seconds between two attempts to compute refused cells. A device may refuse because it is busy; if
# it refuses all cells, each cell costs a call.
RETRY = 10.0

SAMPLED = 1.0
"""Seconds between two samples of a point that a page shows."""

# Points and cells of one view; a window shows fewer.
MOST_POINTS = 500
MOST_CELLS = 16_384

# Cells of one row, which begins at a multiple of this.
CHUNK = 64


class Refreshing:
    """
    Lets a device compute values before they are shown; called under the lock of its mapping.

    Ranges that the device refuses are tried in halves, and the refused cells are not tried again
    for `RETRY` seconds.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._runs: dict[tuple[str, range], list[range]] = {}
        self._until = 0.0
        self._has_failed = False

    def refresh(self, table: str, addresses: range) -> None:
        if (now := time.monotonic()) >= self._until:
            self._until = now + RETRY
            self._runs.clear()
        key = table, addresses
        runs = self._runs.get(key, [addresses])
        good = [each for run in runs for each in self._refreshed(table, run)]
        if good != [addresses]:
            self._runs[key] = good

    def _refreshed(self, table: str, run: range) -> list[range]:
        """Return the parts of a range that were computed."""
        if not run:
            return []
        try:
            self._device.refresh(table, run.start, len(run))
        except ExceptionResponse:
            middle = len(run) // 2
            parts = [run[:middle], run[middle:]] if middle else []
            return [each for part in parts for each in self._refreshed(table, part)]
        except BaseException:  # a hook may raise it to end a server, but must not end the page
            if not self._has_failed:
                self._has_failed = True
                logger.exception("%s %s: before_read failed", table, run)
        return [run]


@dataclass(frozen=True)
class ShownUnit:
    """
    One device.

    Attributes:
        number: 0..255; None for a device that answers every unit.
        name, description: the texts in its device file; empty without a device file.
        points: the named values of the device.
    """

    number: int | None
    device: Device
    name: str = ""
    description: str = ""
    points: tuple[Point, ...] = ()

    @cached_property
    def refreshing(self) -> Refreshing:
        return Refreshing(self.device)

    def movement(self, point: Point) -> bool | None:
        """Return True if a point moves, False if it is held, None if it never moves by itself."""
        return self.device.movement(point) if isinstance(self.device, SimulatedDevice) else None

    def refresh(self, table: str, addresses: range) -> None:
        """Let the device compute values; called under the lock of its mapping."""
        self.refreshing.refresh(table, addresses)

    def cells_and_source(self, point: Point) -> tuple[list[Any], Any]:
        """Return the cells of a point, none without memory, and the value that scales it."""
        with self.device.mapping as mapping:
            self.refresh(point.table, point.cells)
            try:
                table = getattr(mapping, point.table)
                return table[point.cells.start : point.cells.stop], self.source(point)
            except (IndexError, KeyError, ValueError):  # a map may have what the device lacks
                return [], None

    def source(self, point: Point) -> Any:
        """
        Return the value of the point that scales a point.

        Raises:
            IndexError, KeyError, ValueError: the device lacks that point.
        """
        return source_after(point, self.device.points, self.device.mapping)

    @cached_property
    def _by_address(self) -> dict[str, list[Point]]:
        found: dict[str, list[Point]] = {}
        for each in sorted(self.points, key=_place):
            found.setdefault(each.table, []).append(each)
        return found

    def points_from(self, table: str, address: int) -> Iterator[Point]:
        """Yield the points of a table that begin at or after an address, in order."""
        points = self._by_address.get(table, [])
        yield from points[bisect_left(points, (table, address), key=_place) :]

    @cached_property
    def row(self) -> dict[str, Any]:
        """The unit in JSON; its tables as lists of ranges."""
        mapping = self.device.mapping
        tables = {table: getattr(mapping, table).ranges for table in TABLES}
        return {
            "number": self.number,
            "name": self.name,
            "description": self.description,
            "tables": {
                table: [[each.start, each.stop] for each in ranges]
                for table, ranges in tables.items()
                if ranges
            },
            "points": [_point_row(each) for each in self.points],
        }


def _place(point: Point) -> tuple[str, int]:
    return point.table, point.address


def _point_row(point: Point) -> list[Any]:
    many = f" x {point.count}" if point.count > 1 else ""
    order = "" if point.order == "ABCD" else f" {point.order}"
    kind = f"{point.type or 'bit'}{order}{many}"
    return [
        point.name,
        point.table,
        point.address,
        kind,
        point.units,
        point.access,
        point.description,
    ]


@dataclass(frozen=True)
class ShownServer:
    """
    All devices of a server.

    Attributes:
        given: the devices of the server; if the server has other ones, this object is out of date.
    """

    given: Device | Mapping[int, Device]
    units: dict[int | None, ShownUnit]

    def units_of(self, number: int, *, is_line: bool) -> list[int | None]:
        """Return the units that a request addresses, by its unit and kind of connection."""
        if is_line and number == 0:
            return list(self.units)
        if None in self.units:
            return [None]
        # The server itself is its only device (messaging guide, 4.4.2).
        if len(self.units) == 1 and number in SERVER_ITSELF and not is_line:
            return list(self.units)
        return [number] if number in self.units else []


def shown_of(server: Server) -> ShownServer:
    """Return the devices that a server has now."""
    given = server.devices
    devices = {None: given} if isinstance(given, Device) else dict(sorted(given.items()))
    return ShownServer(given, {number: _unit(number, device) for number, device in devices.items()})


def _unit(number: int | None, device: Device) -> ShownUnit:
    """Return a unit; only devices of device files have names."""
    name, description = (str(getattr(device, key, "")) for key in ("name", "description"))
    return ShownUnit(number, device, name, description, tuple(device.points.values()))


# --- rows -----------------------------------------------------------------------------------------

SamplesOf = Callable[[ShownUnit, Point], Samples]


def point_rows(unit: ShownUnit, first: int, stop: int, samples_of: SamplesOf) -> dict[int, Any]:
    """
    Return rows of points: text, True if the point moves, False if held, and its sparkline.

    Args:
        unit: the unit.
        first, stop: the range of their indexes.
        samples_of: returns the samples of a point, to which its value is added once a second.
    """
    now, rows = time.time(), {}
    points = unit.points[first : min(stop, first + MOST_POINTS)]
    for at, point in enumerate(points, first):
        value, text = judged_point(point, *unit.cells_and_source(point))
        samples = samples_of(unit, point)
        if not 0 <= now - samples.newest < SAMPLED:
            samples.add(now, value)
        rows[at] = [text, unit.movement(point), samples.spark(SPARK)]
    return rows


def cell_rows(unit: ShownUnit, name: str, first: int, stop: int) -> dict[int, list[Any]]:
    """
    Return rows of `CHUNK` cells of a table, by the address of the first; None before the table.

    Args:
        unit: the unit.
        name: the name of the table.
        first, stop: the range of addresses; rows are whole.
    """
    mapping = unit.device.mapping
    table: Table[Any] = getattr(mapping, name)
    begin, end = table.addresses.start, table.addresses.stop
    first = max(first, begin)
    first -= first % CHUNK
    stop = min(end, first + MOST_CELLS, stop + -stop % CHUNK)
    begin = max(first, begin)
    if stop <= begin:
        return {}
    with mapping:
        for run in table.ranges:
            unit.refresh(name, range(max(run.start, begin), min(run.stop, stop)))
        start = begin - table.addresses.start
        cells = [None] * (begin - first) + table.view[start : start + stop - begin].tolist()
    return {first + at: cells[at : at + CHUNK] for at in range(0, len(cells), CHUNK)}
