"""
The source of the page of a fleet, a gateway or a watch: a table, its search, charts, and its rows.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol

from ...protocol.checks import integer, number
from .log import Log
from .samples import Pairs, Samples, Series, chart_of, samples_of_each, with_gaps
from .streams import Action, Download, Tables
from .text import cell_text, in_words, value_text

# Rows of one view, of which a window shows fewer; characters of a search; the greatest index.
MOST_VISIBLE = 200
MOST_FOUND = 100
MOST_ROWS = 10_000_000

# Seconds of the longest chart.
MOST_SECONDS = 7 * 86_400.0

# A time of fewer seconds before the samples in memory is not filled from the journal.
SHORTEST = 2.0

# Samples from a journal; a chart has hardly more pixels than a third of them.
MOST_OLDER = 4000

Older = Callable[[str, str, float, float, int], Sequence["tuple[float, float | None]"]]
"""Device, name, since, until and most -> samples of a longer memory, the oldest first."""

# What is searched for, True for problems only, first and end.
View = tuple[str, bool, int, int]


class Column(NamedTuple):
    """A column of the table, which narrow screens leave out if it is wide."""

    title: str
    kind: Literal["row", "note", "value", "number", "age", "state", "spark"]
    is_wide: bool = False


class PageRow(Protocol):
    """A row: the text that is searched, in lower case, and its cells by the titles of columns."""

    @property
    def words(self) -> str: ...

    @property
    def is_problem(self) -> bool: ...

    def cells(self) -> dict[str, Any]: ...


class ShownTable(Protocol):
    """The table of a page and its head; a thread of the page calls the methods."""

    kind: str
    title: str
    columns: Sequence[Column]
    log: Log | None
    older: Older | None

    def status(self) -> tuple[str, bool]: ...

    def figures(self) -> Mapping[str, float]: ...

    def rows(self) -> Sequence[PageRow]: ...

    def series(self, name: tuple[str, str], column: str) -> Series | None: ...


class TableSource:
    """The `PageSource` of a table."""

    script = "table.js"

    def __init__(self, source: ShownTable) -> None:
        self._source = source
        self.actions: Mapping[str, Action] = {"/history": self._history}
        log = source.log
        self.downloads: Mapping[str, Download] = {} if log is None else {"/log.csv": log.download}

    def common(self) -> Tables:
        source, log = self._source, self._source.log
        text, is_problem = source.status()
        head = {
            "kind": source.kind,
            "title": cell_text(source.title),
            "columns": [column._asdict() for column in source.columns],
            "has_log": log is not None,
            "has_journal": source.older is not None,
            "status": {"text": cell_text(text), "is_problem": is_problem},
        }
        return {"head": head, "figures": dict(source.figures()), **(log.tables() if log else {})}

    def view(self, query: Mapping[str, Any]) -> View:
        pattern = query["find"]
        first, stop = (integer(key, query[key], 0, MOST_ROWS) for key in ("first", "stop"))
        if not isinstance(pattern, str) or len(pattern) > MOST_FOUND:
            raise ValueError(f"find must be a string of at most {MOST_FOUND} characters")
        return pattern.lower(), query["problems"] is True, first, min(stop, first + MOST_VISIBLE)

    def tables_of(self, view: View) -> Tables:
        pattern, only, first, stop = view
        rows, words = self._source.rows(), pattern.split()
        if only:
            rows = [row for row in rows if row.is_problem]
        if words:
            rows = [row for row in rows if all(word in row.words for word in words)]
        cells = {at: row.cells() for at, row in enumerate(rows[first:stop], first)}
        return {"view": {"count": len(rows), "find": pattern}, "rows": cells}

    def _history(self, query: Mapping[str, Any]) -> dict[str, Any]:
        name, column = query["row"], query["column"]
        texts = [*name, column] if isinstance(name, list) else []
        if len(texts) != 3 or not all(isinstance(text, str) for text in texts):
            raise ValueError("row must be a list of two strings, and column a string")
        series = self._source.series((name[0], name[1]), column)
        if series is None:
            raise ValueError("this value no longer exists")
        now = time.time()
        since = now - number("seconds", query["seconds"], 1, MOST_SECONDS)
        every = series.samples.every
        pairs = self._with_older(series.samples.pairs(since), name, since, now, every)
        return chart_of(pairs, now, cell_text(series.units), every)

    def _with_older(
        self, recent: Pairs, name: Sequence[str], since: float, now: float, every: float | None
    ) -> Pairs:
        until = recent[0][0] if recent else now
        if self._source.older is None or until - since < SHORTEST:
            return recent
        older = self._source.older(name[0], name[1], since, until, MOST_OLDER)
        # Of each of `MOST_OLDER` / 3 spans of time, a journal returns three samples at most.
        apart = None if every is None else max(every, 2 * 3 / MOST_OLDER * (until - since))
        return with_gaps([*(sample for sample in older if sample[0] < until), *recent], apart)


# --- rows of values, each device's below a row of the device --------------------------------------


COLUMNS = (
    Column("name", "row"),
    Column("state", "state"),
    Column("value", "value"),
    Column("last values", "spark"),
    Column("lowest", "number", is_wide=True),
    Column("highest", "number", is_wide=True),
    Column("age", "age", is_wide=True),
)
"""The columns of pages of values."""


class GroupRow(PageRow, Protocol):
    """The row of a device; it last answered at a time in seconds since the epoch, 0 before."""

    @property
    def is_down(self) -> bool: ...

    @property
    def answered_at(self) -> float: ...


class ShownPoint(NamedTuple):
    """A point; seconds between two values are None if one comes only when it has changed."""

    device: str
    name: str
    units: str
    every: float | None


@dataclass(slots=True)
class ValueRow:
    """See `PageRow`: a reading is time, device, name, value, unit, quality, reason, and more."""

    point: ShownPoint
    device: GroupRow
    samples: Samples
    reading: tuple[Any, ...] | None = None

    @property
    def words(self) -> str:
        return f"{self.point.device} {self.point.name} {self.point.units}".lower()

    @property
    def is_problem(self) -> bool:
        """True if there is no good value, although the device answers."""
        return self.reading is not None and self.reading[5] != "good" and not self.device.is_down

    def cells(self) -> dict[str, Any]:
        point, reading, samples = self.point, self.reading, self.samples
        name = {"group": cell_text(point.device), "own": cell_text(point.name)}
        units = cell_text(point.units)
        if reading is None:
            empty = {"value": {"text": "", "units": units}, "last values": []}
            return {"name": name, "state": {"word": "new"}, **empty}
        is_good = reading[5] == "good"
        age = max(reading[0], self.device.answered_at) if is_good else reading[0]
        reason = "" if self.device.is_down else re.sub("^Modbus|Error$", "", reading[6])
        text = "-" if reading[3] is None else value_text(reading[3])
        value, spark = {"text": text, "units": units}, samples.spark()
        state = {"word": reading[5], "reason": cell_text(in_words(reason))}
        bounds = {"lowest": samples.low, "highest": samples.high}
        texts = {key: "" if bound is None else value_text(bound) for key, bound in bounds.items()}
        row = {"name": name, "state": state, "value": value, "last values": spark}
        return {**row, **texts, "age": round(age, 1)}


class Values:
    """The rows of devices, made by their names, and of their values. Thread-safe."""

    def __init__(self, device_row: Callable[[str], GroupRow]) -> None:
        self._device_row = device_row
        self._values: dict[tuple[str, str], ValueRow] = {}
        self.rows: list[PageRow] = []

    def describe(self, points: Iterable[ShownPoint]) -> None:
        """Take new points, each device's together, and keep the values of those that stay."""
        before, rows, after = self._values, list[PageRow](), dict[tuple[str, str], ValueRow]()
        point_list = list(points)
        most, devices = samples_of_each(len(point_list)), dict[str, GroupRow]()
        for point in point_list:
            if point.device not in devices:
                devices[point.device] = self._device_row(point.device)
                rows.append(devices[point.device])
            key, device = (point.device, point.name), devices[point.device]
            row = after[key] = before.get(key) or ValueRow(point, device, Samples(None, most))
            row.point, row.device, row.samples.every = point, device, point.every
            row.samples.resize(most)
            rows.append(row)
        self._values, self.rows = after, rows

    def put_readings(self, readings: Iterable[tuple[Any, ...]]) -> None:
        """Take readings, each with the fields of `ValueRow.reading`."""
        for reading in readings:
            value = self._values.get((reading[1], reading[2]))
            if value is not None:
                value.reading = reading
                value.samples.add(reading[0], reading[3])

    def bad(self) -> list[ValueRow]:
        """Return the values that are not good, although their device answers."""
        return [value for value in self._values.values() if value.is_problem]

    def series(self, name: tuple[str, str], column: str) -> Series | None:
        """Return the numbers of a value; None if there is no such value."""
        value = self._values.get(name)
        return None if value is None else Series(value.samples, value.point.units)


def problem_text(error: Exception | str) -> str:
    """Return the reason in the text of an error, without the request before it."""
    text = str(error) or type(error).__name__
    return cell_text(text.rpartition("): ")[2])
