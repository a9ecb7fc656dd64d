"""
The values of read --watch as a page shows them.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

from ...tools.page.log import Log
from ...tools.page.samples import Series
from ...tools.page.table_source import COLUMNS, Column, Older, PageRow, ShownPoint, Values
from ...tools.page.text import cell_text
from .formatters import ReadResult
from .reading import Printer

__all__ = ["ShownWatch"]


class ShownWatch:
    """
    See `Shown` of the page; as a printer, it passes everything on to another one.

    Args:
        title: the device, its units and the interval.
        printer: prints the values.
        every: seconds between two polls of a unit.
    """

    kind = "watch"
    log: Log | None = None
    older: Older | None = None
    columns: Sequence[Column] = COLUMNS

    def __init__(self, title: str, printer: Printer, every: float) -> None:
        self.title = title
        self._printer = printer
        self._every = every
        self._units: dict[str, WatchedUnit] = {}
        self._values = Values(self._unit)
        self._polls = self._failed = 0
        # Unit and number of an item -> the names and units of measurement of its values.
        self._names: dict[tuple[int, int], list[tuple[str, str]]] = {}

    def status(self) -> tuple[str, bool]:
        """Return which units do not answer, or that all do."""
        down = [each.name for each in self._units.copy().values() if each.is_down]
        if down:
            return f"no answer from {', '.join(down)}", True
        return ("the device answers", False) if self._units else ("no answer yet", False)

    def figures(self) -> Mapping[str, float]:
        return {"polls": self._polls, "failed": self._failed}

    def rows(self) -> Sequence[PageRow]:
        return self._values.rows or list(self._units.copy().values())

    def series(self, name: tuple[str, str], column: str) -> Series | None:
        return self._values.series(name, column)

    def print(self, unit: int, results: Sequence[ReadResult]) -> None:
        self._printer.print(unit, results)
        self._polls += 1
        self._failed += any(each.failure for each in results)
        now, known = time.time(), dict(self._names)
        self._unit(_device(unit)).take(now, "")
        for at, each in enumerate(results):
            if each.rows:
                self._names[unit, at] = [_name(each, row) for row in each.rows]
        if self._names != known:
            self._values.describe(
                ShownPoint(_device(number), *name, self._every)
                for (number, _), names in sorted(self._names.items())
                for name in names
            )
        for at, each in enumerate(results):
            if each.failure:
                self._put_failure(now, unit, at, "bad", each.failure)
            reason = "Fell" if each.has_fallen else ""
            for row in each.rows:
                self._put(now, unit, _name(each, row), row, reason)

    def fail(self, unit: int, reason: str) -> None:
        self._printer.fail(unit, reason)
        self._polls += 1
        self._failed += 1
        now = time.time()
        self._unit(_device(unit)).take(now, reason)
        for number, at in self._names:
            if number == unit:
                self._put_failure(now, unit, at, "down", reason)

    def _unit(self, name: str) -> WatchedUnit:
        return self._units.setdefault(name, WatchedUnit(name))

    def _put(self, now: float, unit: int, name: tuple[str, str], row: Any, reason: str) -> None:
        value, quality = _value(row.plain), "good"
        if row.plain == "" and row.unit.startswith("("):  # the reason why there is no value
            value, quality, reason = None, "bad", row.unit[1:-1]
        self._values.put([(now, _device(unit), name[0], value, name[1], quality, reason)])

    def _put_failure(self, now: float, unit: int, at: int, quality: str, reason: str) -> None:
        for name, units in self._names.get((unit, at), []):
            self._values.put([(now, _device(unit), name, None, units, quality, reason)])


class WatchedUnit:
    """See `GroupRow`: whether a unit answers, since when, and why not."""

    def __init__(self, name: str) -> None:
        self.name: str = name
        self.words: str = name
        self.answered_at: float = 0.0
        self._reason: str | None = None  # of a unit that does not answer; None before the first
        self._since = 0.0

    @property
    def is_down(self) -> bool:
        return bool(self._reason)

    @property
    def is_problem(self) -> bool:
        return self.is_down

    def take(self, now: float, reason: str) -> None:
        """Take the outcome of a poll: why there is no answer, or an empty text."""
        if self._reason is None or bool(self._reason) != bool(reason):
            self._since = now
        self._reason = reason
        if not reason:
            self.answered_at = now

    def cells(self) -> list[Any]:
        state = ["down" if self.is_down else "up", cell_text(self._reason or ""), self._since]
        return [["", self.name], state, ["", ""], None, "", "", round(self.answered_at, 1)]


def _device(unit: int) -> str:
    return f"unit {unit}"


def _name(result: ReadResult, row: Any) -> tuple[str, str]:
    """Return the name of a value, and its unit of measurement."""
    item = result.formatter.item
    where = row.where.strip()
    if item.point is not None:
        return where, item.point.units
    return f"{item.word} {where}".strip(), ""


def _value(text: str) -> int | float | str | None:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
