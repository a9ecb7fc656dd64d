"""
The points or cells that a page shows, and which of them have changed.

Values that a device computes are computed for the page as for clients. Where the device refuses,
because clients may not read them, the page shows the cells as they are.
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterable
from typing import Any

from ...device.mapping import Table
from ...device.named_values import source_of
from ...maps.point import Point
from ...protocol.spelling import shown
from .refreshing import Refreshing
from .shown import ShownUnit
from .source import Changes

__all__ = ["MOST_CELLS", "MOST_POINTS", "CellsView", "PointsView"]

MOST_POINTS = 500
MOST_CELLS = 16_384

# Cells are compared and sent in chunks of this size.
CHUNK = 64

# Characters of a value that a row can show.
MOST_TEXT = 200


class PointsView:
    """
    Points of one unit.

    Args:
        first, stop: the range of their indexes.
    """

    def __init__(self, unit: ShownUnit, first: int, stop: int) -> None:
        self.unit = unit
        self._points = dict(enumerate(unit.points[first : min(stop, first + MOST_POINTS)], first))
        self._by_name = {each.name: each for each in unit.points}
        self._cells: dict[int, tuple[list[Any], Any]] = {}
        self._texts: dict[int, str] = {}
        self._refreshing = Refreshing(unit.device)

    def look(self) -> Changes:
        changed = {}
        for at, point in self._points.items():
            cells, source = self._look_at(point)
            if (cells, source) != self._cells.get(at):
                self._cells[at] = cells, source
                text = _text(point, cells, source)
                if text != self._texts.get(at):
                    changed[at] = self._texts[at] = text
        return {"points": changed} if changed else {}

    def all(self) -> Changes:
        return {"points": self._texts}

    def _look_at(self, point: Point) -> tuple[list[Any], Any]:
        """Return the cells of a point, and the value of the point that scales it."""
        with self.unit.device.mapping as mapping:
            self._refreshing.refresh(point.table, point.cells)
            try:
                table: Table[Any] = getattr(mapping, point.table)
                cells: list[Any] = table[point.cells.start : point.cells.stop]
                source = source_of(mapping, self._by_name, point)
            except (IndexError, KeyError, ValueError):  # a map may have what the device lacks
                cells, source = [], None
        return cells, source


def _text(point: Point, cells: list[Any], source: Any) -> str:
    try:
        value, _, reason = point.judge(cells, source=source)
    except (TypeError, ValueError) as error:
        return "no such cells" if not cells else f"? {error}"
    if value is None:
        return f"- ({reason})"
    values = value if point.count > 1 else [value]
    text = ", ".join(_text_of(point, each) for each in values[:MOST_TEXT])
    return text if len(text) <= MOST_TEXT else f"{text[:MOST_TEXT]}..."


def _text_of(point: Point, value: Any) -> str:
    kind = point.read.kind
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, str):
        return value if value.isprintable() else reprlib.repr(value)
    if isinstance(value, dict):
        return " ".join(f"{name}={int(each)}" for name, each in value.items())
    is_plain = (
        kind is not None
        and not point.is_part
        and (point.scale, point.offset, point.scale_from) == (1, 0, None)
    )
    return shown(value, kind) if is_plain and kind is not None else str(value)


class CellsView:
    """
    Cells of one table.

    Args:
        first, stop: the range of their addresses.
    """

    def __init__(self, unit: ShownUnit, table: str, first: int, stop: int) -> None:
        self.unit = unit
        self._table: Table[Any] = getattr(unit.device.mapping, table)
        addresses = self._table.addresses
        self._first = max(first, addresses.start)
        self._stop = min(stop, addresses.stop, self._first + MOST_CELLS)
        begin, end = self._first - addresses.start, self._stop - addresses.start
        self._view = self._table.view[begin : max(begin, end)]
        self._before = b""
        self._refreshing = Refreshing(unit.device)
        self._inside = [
            range(max(each.start, self._first), min(each.stop, self._stop))
            for each in self._table.ranges
        ]

    def look(self) -> Changes:
        with self.unit.device.mapping:
            for run in self._inside:
                self._refreshing.refresh(self._table.name, run)
            now = self._view.tobytes()
        before, self._before = self._before, now
        if before == now:
            return {}
        step = CHUNK * self._view.itemsize
        starts = range(0, len(now), step)
        changed = [at for at in starts if before[at : at + step] != now[at : at + step]]
        return self._cells(at // self._view.itemsize for at in changed)

    def all(self) -> Changes:
        return self._cells(range(0, len(self._before) // self._view.itemsize, CHUNK))

    def _cells(self, starts: Iterable[int]) -> Changes:
        cells = memoryview(self._before).cast(self._table.typecode)
        found = {self._first + at: cells[at : at + CHUNK].tolist() for at in starts}
        return {"cells": found} if found else {}
