"""The values of read --watch as a page shows them."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

from ...tools.page.log import Log
from ...tools.page.samples import Series
from ...tools.page.table_source import COLUMNS, Column, Older, PageRow, ShownPoint, Values
from ...tools.page.text import cell_text, first_names
from .formatters import ReadResult, ValueText
from .items import Item


class ShownWatch:
    """See `ShownTable` of the page; polls of a unit are `every` seconds apart."""

    kind = "watch"
    log: Log | None = None
    older: Older | None = None
    columns: Sequence[Column] = COLUMNS

    def __init__(self, title: str, every: float) -> None:
        self.title = title
        self._every = every
        self._units: dict[str, WatchedUnit] = {}
        self._values = Values(self._unit)
        self._polls = self._failed = 0
        # Unit and number of an item -> the names and units of measurement of its values.
        self._names: dict[tuple[int, int], list[tuple[str, str]]] = {}

    def status(self) -> tuple[str, bool]:
        """Return which units do not answer and which values are not good, or that all are."""
        down = [unit.name for unit in self._units.copy().values() if unit.is_down]
        bad = [f"{reading.point.device} {reading.point.name}" for reading in self._values.bad()]
        problems = [f"no answer from {', '.join(down)}"] if down else []
        if bad:
            problems.append(f"values that are not good: {len(bad)}{first_names(bad)}")
        if not self._units:
            problems.append("no answer yet")
        return ("; ".join(problems), True) if problems else ("the device answers", False)

    def figures(self) -> Mapping[str, float]:
        return {"polls": self._polls, "failed": self._failed}

    def rows(self) -> Sequence[PageRow]:
        return self._values.rows or list(self._units.copy().values())

    def series(self, name: tuple[str, str], column: str) -> Series | None:
        return self._values.series(name, column)

    def print(self, unit: int, results: Sequence[ReadResult], reason: str) -> None:
        """Take the results of a unit, or the reason why there are none."""
        now, device = time.time(), _device(unit)
        self._polls += 1
        self._failed += bool(reason) or any(result.failure for result in results)
        self._unit(device).take(now, reason)
        self._describe(unit, results)
        readings: list[tuple[Any, ...]] = []
        own = {at: names for (number, at), names in self._names.items() if number == unit}
        for at, names in own.items():
            if failure := reason or results[at].failure:
                quality = "down" if reason else "bad"
                readings += [(now, device, name, None, of, quality, failure) for name, of in names]
                continue
            mark = "Fell" if results[at].has_fallen else ""
            readings += [  # an empty queue has no values
                (now, device, name, _value(row.plain), of, "good", mark)
                if row.plain or not row.unit
                else (now, device, name, None, of, "bad", row.unit[1:-1])
                for (name, of), row in zip(names, results[at].rows, strict=False)
            ]
        self._values.put_readings(readings)

    def _describe(self, unit: int, results: Sequence[ReadResult]) -> None:
        """Set the rows of the table again if the values of a unit have other names now."""
        names = {
            (unit, at): [_name(result.item, row) for row in result.rows]
            or [_first_name(result.item)]
            for at, result in enumerate(results)
            if result.rows or (unit, at) not in self._names
        }
        if names.items() <= self._names.items():
            return
        self._names |= names
        self._values.describe(
            ShownPoint(_device(number), *name, self._every)
            for (number, _), names in sorted(self._names.items())
            for name in names
        )

    def _unit(self, name: str) -> WatchedUnit:
        return self._units.setdefault(name, WatchedUnit(name))


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

    is_problem = is_down

    def take(self, now: float, reason: str) -> None:
        """Take the outcome of a poll: the reason for no answer, or an empty text."""
        if self._reason is None or bool(self._reason) != bool(reason):
            self._since = now
        self._reason = reason
        if not reason:
            self.answered_at = now

    def cells(self) -> dict[str, Any]:
        word, reason = "down" if self.is_down else "up", cell_text(self._reason or "")
        state = {"word": word, "reason": reason, "since": self._since}
        row = {"name": {"group": "", "own": self.name}, "state": state}
        return {**row, "value": {"text": "", "units": ""}, "age": round(self.answered_at, 1)}


def _device(unit: int) -> str:
    return f"unit {unit}"


def _name(item: Item, row: ValueText) -> tuple[str, str]:
    where = row.where.strip()
    if item.point is not None:
        return where, item.point.units
    return f"{item.word} {where}".strip(), ""


def _first_name(item: Item) -> tuple[str, str]:
    """Return the name of the first value of an item that has had none yet."""
    return (item.label(), "") if item.point is None else (item.point.name, item.point.units)


def _value(text: str) -> int | float | str | None:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
