"""
The units of a server, with rows of their points and cells, as a page shows them.

Values that a device computes when they are read are computed for the page as for clients. Where the
device refuses, because clients may not read them, the page shows the cells as they are.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import cached_property
from typing import Any, NamedTuple

from ...device.device import Device
from ...device.mapping import Table
from ...device.named_values import PointIndex, RuledCells, source_after
from ...maps.point import Point
from ...protocol.errors import ExceptionResponse
from ...protocol.logs import HarmlessLogger
from ...protocol.tables import TABLES
from ...server.server import Server
from ..simulator.simulated import SimulatedDevice
from .samples import Samples, samples_of_each
from .text import point_text

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


class ShownUnit:
    """One device of a server; its number is None if it answers every unit."""

    def __init__(self, number: int | None, device: Device) -> None:
        self.number: int | None = number
        self.device: Device = device
        self.points: tuple[Point, ...] = tuple(device.points.values())
        self.samples: dict[str, Samples] = {}
        self._runs: dict[tuple[str, range], list[range]] = {}
        self._until = 0.0
        self._has_failed = False

    def movement(self, point: Point) -> bool | None:
        """Return True if a point moves, False if it is held, None if it never moves by itself."""
        return self.device.movement(point) if isinstance(self.device, SimulatedDevice) else None

    def refresh(self, table: str, addresses: range) -> None:
        """
        Let the device compute cells before they are shown; called under the lock of its mapping.

        A range that it refuses is tried in halves; refused cells are not tried for `RETRY` seconds.
        """
        if (now := time.monotonic()) >= self._until:
            self._until = now + RETRY
            self._runs.clear()
        key = table, addresses
        runs = self._runs.get(key, [addresses])
        self._runs[key] = [cell for run in runs for cell in self._refreshed(table, run)]

    def _refreshed(self, table: str, run: range) -> list[range]:
        """Return the parts of a range that were computed."""
        try:
            self.device.refresh(table, run.start, len(run))
        except ExceptionResponse:
            middle = len(run) // 2
            parts = [run[:middle], run[middle:]] if middle else []
            return [cell for part in parts for cell in self._refreshed(table, part)]
        except BaseException:  # a hook may raise it to end a server, but must not end the page
            if not self._has_failed:
                self._has_failed = True
                logger.exception("%s %s: before_read failed", table, run)
        return [run]

    def value_and_text(self, point: Point, cells: list[Any] | None = None) -> tuple[Any, str]:
        """Return the value of a point, or None, and its text; of its cells now, or of others."""
        with self.device.mapping as mapping:
            if cells is None:
                self.refresh(point.table, point.cells)
            try:
                own = getattr(mapping, point.table)[point.cells.start : point.cells.stop]
                source = source_after(point, self.device.points, mapping)
            except (IndexError, KeyError, ValueError):  # a map may have what the device lacks
                own, source = [], None
        return point_text(point, own if cells is None else cells, source)

    @cached_property
    def index(self) -> PointIndex:
        return PointIndex(map(RuledCells.of, self.points))

    @cached_property
    def row(self) -> dict[str, Any]:
        """The unit in JSON; its tables as lists of ranges. Only devices of files have names."""
        mapping = self.device.mapping
        tables = {table: getattr(mapping, table).ranges for table in TABLES}
        return {
            "number": self.number,
            "name": str(getattr(self.device, "name", "")),
            "description": str(getattr(self.device, "description", "")),
            "tables": {
                table: [[cells.start, cells.stop] for cells in ranges]
                for table, ranges in tables.items()
                if ranges
            },
            "points": [_point_row(point) for point in self.points],
        }


def _point_row(point: Point) -> dict[str, Any]:
    many = f" x {point.count}" if point.count > 1 else ""
    order = "" if point.order == "ABCD" else f" {point.order}"
    keys = ("name", "table", "address", "units", "access", "description")
    row = {key: getattr(point, key) for key in keys}
    return {**row, "type": f"{point.type or 'bit'}{order}{many}"}


class ShownServer(NamedTuple):
    """The devices that a server was given, and its units with them."""

    devices: Device | Mapping[int, Device]
    units: dict[int | None, ShownUnit]

    def units_of(self, number: int, *, is_line: bool) -> list[int | None]:
        """Return the units that a request addresses, by its unit and kind of connection."""
        if is_line and number == 0:
            return list(self.units)
        if None in self.units:
            return [None]
        # The server itself is its only device (messaging guide, 4.4.2).
        if len(self.units) == 1 and number in (0, 255) and not is_line:
            return list(self.units)
        return [number] if number in self.units else []


def shown_of(server: Server) -> ShownServer:
    source = server.devices
    devices = {None: source} if isinstance(source, Device) else dict(sorted(source.items()))
    units = {number: ShownUnit(number, device) for number, device in devices.items()}
    return ShownServer(source, units)


def point_rows(unit: ShownUnit, first: int, stop: int) -> dict[int, Any]:
    """Return rows of points: text, movement and sparkline, for a sample of each once a second."""
    now, most, rows = time.time(), samples_of_each(len(unit.points)), {}
    points = unit.points[first : min(stop, first + MOST_POINTS)]
    for at, point in enumerate(points, first):
        value, text = unit.value_and_text(point)
        samples = unit.samples.setdefault(point.name, Samples(SAMPLED, most))
        if not 0 <= now - samples.newest < SAMPLED:
            samples.add(now, value)
        rows[at] = {"text": text, "moves": unit.movement(point), "spark": samples.spark()}
    return rows


def cell_rows(unit: ShownUnit, name: str, first: int, stop: int) -> dict[int, list[Any]]:
    """Return rows of `CHUNK` cells of a table, by the address of the first; None before it."""
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
            part = range(max(run.start, begin), min(run.stop, stop))
            if part:
                unit.refresh(name, part)
        start = begin - table.addresses.start
        cells = [None] * (begin - first) + table.view[start : start + stop - begin].tolist()
    return {first + at: cells[at : at + CHUNK] for at in range(0, len(cells), CHUNK)}
