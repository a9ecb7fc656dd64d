"""
The points or cells that a page shows, and which of them have changed.

Values that a device computes are computed for the page as for clients. Where the device refuses,
because clients may not read them, the page shows the cells as they are.
"""

from __future__ import annotations

import reprlib
import time
from collections.abc import Callable, Iterable
from typing import Any

from ...device.mapping import Table
from ...device.named_values import source_after
from ...maps.point import Point
from ...protocol.spelling import text_of
from .refreshing import Refreshing
from .samples import Samples
from .shown import ShownUnit
from .source import Changes

__all__ = ["MOST_CELLS", "MOST_POINTS", "CellsView", "PointsView", "point_text"]

MOST_POINTS = 500
MOST_CELLS = 16_384

# Cells are compared and sent in chunks of this size.
CHUNK = 64

# Seconds between two samples of a point that a page shows, and the most samples of its sparkline.
SAMPLED = 1.0
SPARK = 60

# The most characters of a value that a row can show.
MOST_TEXT = 200


class PointsView:
    """
    Points of one unit.

    Args:
        first, stop: the range of their indexes.
        samples_of: returns the samples of a point, to which its values are added.
    """

    def __init__(
        self,
        unit: ShownUnit,
        first: int,
        stop: int,
        samples_of: Callable[[ShownUnit, Point], Samples] = lambda unit, point: Samples(),
    ) -> None:
        self.unit = unit
        self._points = dict(enumerate(unit.points[first : min(stop, first + MOST_POINTS)], first))
        self._by_name = {each.name: each for each in unit.points}
        self._cells: dict[int, tuple[list[Any], Any]] = {}
        self._texts: dict[int, str] = {}
        self._values: dict[int, Any] = {}
        self._samples = {at: samples_of(unit, point) for at, point in self._points.items()}
        self._sampled = 0.0
        self._sparks: dict[int, list[int]] = {}
        self._moving: dict[int, bool] = {}
        self._can_move = [
            at for at, point in self._points.items() if unit.movement(point) is not None
        ]
        self._refreshing = Refreshing(unit.device)

    def look(self) -> Changes:
        changed = {}
        for at, point in self._points.items():
            cells, source = self._look_at(point)
            if (cells, source) != self._cells.get(at):
                self._cells[at] = cells, source
                self._values[at], text = judged_point(point, cells, source)
                if text != self._texts.get(at):
                    changed[at] = self._texts[at] = text
        found: Changes = {"points": changed} if changed else {}
        moving = {at: self.unit.movement(self._points[at]) is True for at in self._can_move}
        if moving != self._moving:
            self._moving = found["moving"] = moving
        if sparks := self._new_sparks():
            found["sparks"] = sparks
        return found

    def _new_sparks(self) -> dict[int, list[int]]:
        """Add the values to their samples, once a second, and return the lines that changed."""
        now = time.time()
        if 0 <= now - self._sampled < SAMPLED:
            return {}
        self._sampled = now
        changed = {}
        for at, samples in self._samples.items():
            samples.add(now, self._values.get(at))
            levels = samples.spark(SPARK)
            if levels != self._sparks.get(at):
                changed[at] = self._sparks[at] = levels
        return changed

    def all(self) -> Changes:
        return {"points": self._texts, "moving": self._moving, "sparks": self._sparks}

    def _look_at(self, point: Point) -> tuple[list[Any], Any]:
        """Return the cells of a point, and the value of the point that scales it."""
        with self.unit.device.mapping as mapping:
            self._refreshing.refresh(point.table, point.cells)
            try:
                table: Table[Any] = getattr(mapping, point.table)
                cells: list[Any] = table[point.cells.start : point.cells.stop]
                source = source_after(point, self._by_name, mapping)
            except (IndexError, KeyError, ValueError):  # a map may have what the device lacks
                cells, source = [], None
        return cells, source


def point_text(point: Point, cells: list[Any], source: Any) -> str:
    """Return the value of a point as a row shows it, or the reason that it has none."""
    return judged_point(point, cells, source)[1]


def judged_point(point: Point, cells: list[Any], source: Any) -> tuple[Any, str]:
    """Return the value of a point, or None if it has none, and the text that a row shows."""
    try:
        value, _, reason = point.judge(cells, source=source)
    except (TypeError, ValueError) as error:
        return None, "no such cells" if not cells else f"? {error}"
    if value is None:
        return None, f"- ({reason})"
    return value, _value_text(point, value)


def _value_text(point: Point, value: Any) -> str:
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
    return text_of(value, kind) if is_plain and kind is not None else str(value)


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
