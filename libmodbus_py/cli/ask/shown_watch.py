"""
The values of read --watch as a page shows them.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

from ...tools.page.log import Log
from ...tools.page.table_source import Older
from ...tools.page.tables import PageTable, ValuesTable
from .formatters import ReadResult
from .reading import Printer

__all__ = ["ShownWatch"]


class ShownWatch:
    """
    See `Shown` of the page; as a printer, it passes everything on to another one.

    Args:
        title: the device, its units and the interval.
        printer: prints the values.
    """

    kind = "watch"
    log: Log | None = None
    older: Older | None = None

    def __init__(self, title: str, printer: Printer) -> None:
        self.title = title
        self._printer = printer
        self._values = ValuesTable()
        self.tables: Sequence[PageTable] = (self._values,)
        self._polls = self._failed = 0
        # Unit and number of an item -> the names and units of measurement of its values.
        self._names: dict[tuple[int, int], list[tuple[str, str]]] = {}

    def figures(self) -> Mapping[str, float]:
        return {"polls": self._polls, "failed": self._failed}

    def print(self, unit: int, results: Sequence[ReadResult]) -> None:
        self._printer.print(unit, results)
        self._polls += 1
        self._failed += any(each.failure for each in results)
        now, known = time.time(), dict(self._names)
        for at, each in enumerate(results):
            if each.rows:
                self._names[unit, at] = [_name(each, row) for row in each.rows]
        if self._names != known:
            self._values.describe(
                (_device(number), *name)
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
        for number, at in self._names:
            if number == unit:
                self._put_failure(time.time(), unit, at, "down", reason)

    def _put(self, now: float, unit: int, name: tuple[str, str], row: Any, reason: str) -> None:
        value, quality = _value(row.plain), "good"
        if row.plain == "" and row.unit.startswith("("):  # the reason why there is no value
            value, quality, reason = None, "bad", row.unit[1:-1]
        self._values.put([(now, _device(unit), name[0], value, name[1], quality, reason)])

    def _put_failure(self, now: float, unit: int, at: int, quality: str, reason: str) -> None:
        for name, units in self._names.get((unit, at), []):
            self._values.put([(now, _device(unit), name, None, units, quality, reason)])


def _device(unit: int) -> str:
    return f"unit {unit}"


def _name(result: ReadResult, row: Any) -> tuple[str, str]:
    """Return the name of a value, and its unit of measurement."""
    item = result.formatter.item
    where = row.where.strip()
    if item.point is not None:
        return where, item.point.units
    return f"{item.word} {where}", ""


def _value(text: str) -> int | float | str | None:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
