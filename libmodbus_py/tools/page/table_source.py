"""
The source of a page of tables: the rows that each page shows, and the history of a value.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from ...protocol.checks import integer, number
from .log import Log
from .samples import MOST_PAIRS, Pairs, charted
from .source import Action, Changes, Download
from .tables import PageTable, cell_text

__all__ = ["MOST_VISIBLE", "Older", "Shown", "TableSource", "TableView"]

MOST_VISIBLE = 200
"""The most rows of one view."""

MOST_FOUND = 100
"""The most characters of a search text."""

MOST_ROWS = 10_000_000

MOST_SECONDS = 7 * 86_400.0

# A gap of fewer seconds before the samples in memory is not filled from the journal.
SHORTEST = 2.0

# Seconds between two selections of the rows with problems.
SELECTED = 1.0

Older = Callable[[str, str, float, float, int], Sequence["tuple[float, float | None]"]]
"""Device, name, since, until and most -> samples of a longer memory, the oldest first."""

# Table, what is searched for, True for trouble only, first and end.
Key = tuple[str, str, bool, int, int]


class Shown(Protocol):
    """
    The tables of a page, and their title.
    """

    @property
    def kind(self) -> str:
        """The kind of the page in one word, such as "fleet"."""
        ...

    @property
    def title(self) -> str:
        """The title of the page."""
        ...

    @property
    def tables(self) -> Sequence[PageTable]:
        """The tables, in the order of their tabs."""
        ...

    @property
    def log(self) -> Log | None:
        """The log that is shown beside the tables; None for no log."""
        ...

    @property
    def older(self) -> Older | None:
        """Finds samples of values that are not in memory any more; None without a journal."""
        ...

    def figures(self) -> Mapping[str, float]:
        """Return the numbers at a glance, by their names."""
        ...


class TableSource:
    """
    A `PageSource` of tables.

    Args:
        shown: the tables.
    """

    document = "tables.html"

    def __init__(self, shown: Shown) -> None:
        self._shown = shown
        self._tables = {each.name: each for each in shown.tables}
        self._structure = object()
        self._figures: dict[str, float] = {}
        self._passed = 0
        self.actions: Mapping[str, Action] = {"/history": self._history}
        log = shown.log
        self.downloads: Mapping[str, Download] = {} if log is None else {"/log.csv": log.download}

    def structure(self) -> object:
        return self._structure

    def described(self) -> Changes:
        shown = self._shown
        tables = [
            {
                "name": each.name,
                "title": each.title,
                "columns": [list(column) for column in each.columns],
            }
            for each in shown.tables
        ]
        return {
            "kind": shown.kind,
            "title": cell_text(shown.title),
            "tables": tables,
            "has_log": shown.log is not None,
            "has_journal": shown.older is not None,
        }

    def everything(self) -> Changes:
        log = self._shown.log
        return {
            "now": time.time(),
            "figures": self._figures,
            **({} if log is None else {"log": log.rows()}),
        }

    def changes(self) -> Changes:
        found: Changes = {}
        figures = dict(self._shown.figures())
        if figures != self._figures:
            self._figures = figures
            found = {"now": time.time(), "figures": figures}
        if self._shown.log is not None and (rows := self._shown.log.rows(self._passed)):
            self._passed = rows[-1].number
            found["log"] = rows
        return found

    # --- views ---------------------------------------------------------------------------------

    def key(self, given: Mapping[str, Any]) -> Key:
        name, wanted = given["table"], given["find"]
        first, stop = (integer(each, given[each], 0, MOST_ROWS) for each in ("first", "stop"))
        if not isinstance(name, str) or name not in self._tables:
            raise ValueError("there is no such table")
        if not isinstance(wanted, str) or len(wanted) > MOST_FOUND:
            raise ValueError(f"find must be a string of at most {MOST_FOUND} characters")
        only = given["trouble"] is True
        return name, wanted.lower(), only, first, min(stop, first + MOST_VISIBLE)

    def view(self, key: Key) -> TableView:
        name, wanted, only, first, stop = key
        return TableView(self._tables[name], wanted, only, first, stop)

    def is_current(self, view: TableView) -> bool:
        return True

    def named(self, key: Key) -> Changes:
        return {"table": key[0], "find": key[1], "trouble": key[2]}

    # --- history -------------------------------------------------------------------------------

    def _history(self, given: Mapping[str, Any]) -> Changes:
        table, name, column = given["table"], given["row"], given["column"]
        if not isinstance(table, str) or table not in self._tables:
            raise ValueError("there is no such table")
        if not isinstance(name, list) or len(name) != 2 or not _are_texts([*name, column]):
            raise ValueError("row must be a list of two strings, and column a string")
        series = self._tables[table].series((name[0], name[1]), column)
        if series is None:
            raise ValueError("this value no longer exists")
        now = time.time()
        since = now - number("seconds", given["seconds"], 1, MOST_SECONDS)
        pairs = series.samples.pairs(since)
        pairs = self._with_older(pairs, name, since, now)
        return charted(pairs, now, cell_text(series.units), is_stepped=series.is_stepped)

    def _with_older(self, recent: Pairs, name: Sequence[str], since: float, now: float) -> Pairs:
        until = recent[0][0] if recent else now
        if self._shown.older is None or until - since < SHORTEST:
            return recent
        older = self._shown.older(name[0], name[1], since, until, 4 * MOST_PAIRS)
        return [*(each for each in older if each[0] < until), *recent]


def _are_texts(given: Sequence[object]) -> bool:
    return all(isinstance(each, str) for each in given)


class TableView:
    """
    A `PageView` of rows of a table.

    Args:
        wanted: the words that a row must contain, in lower case.
        only: True to show only rows with problems.
        first, stop: the range of the rows, among the rows that match.
    """

    def __init__(self, table: PageTable, wanted: str, only: bool, first: int, stop: int) -> None:
        self._table = table
        self._wanted = wanted.split()
        self._only = only
        self._first = first
        self._stop = stop
        self._from: object = None
        self._selected: Sequence[Any] = ()
        self._until = 0.0
        self._count = -1
        self._stamps: list[Any] = []
        self._cells: list[list[Any]] = []

    def look(self) -> Changes:
        rows = self._select()[self._first : self._stop]
        table = self._table
        stamps = [(row, table.stamp(row)) for row in rows]
        changed = {}
        for at, stamp in enumerate(stamps):
            if at >= len(self._stamps) or stamp != self._stamps[at]:
                cells = table.cells(rows[at])
                if at >= len(self._cells):
                    self._cells.append([])
                if cells != self._cells[at]:
                    changed[self._first + at] = self._cells[at] = cells
        self._stamps = stamps
        del self._cells[len(rows) :]
        if not changed and self._count == len(self._selected):
            return {}
        self._count = len(self._selected)
        return {"count": self._count, "rows": changed}

    def all(self) -> Changes:
        return {"count": max(0, self._count), "rows": dict(enumerate(self._cells, self._first))}

    def _select(self) -> Sequence[Any]:
        rows = self._table.rows()
        if not (self._wanted or self._only):
            self._selected = rows
        elif rows is not self._from or (self._only and time.monotonic() >= self._until):
            self._selected = [each for each in rows if self._is_wanted(each)]
            self._until = time.monotonic() + SELECTED
        self._from = rows
        return self._selected

    def _is_wanted(self, row: Any) -> bool:
        if self._only and not self._table.is_trouble(row):
            return False
        if not self._wanted:
            return True
        words = self._table.words(row)
        return all(each in words for each in self._wanted)
