"""
One line for each poll: text, CSV or JSON, with its time.
"""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Any

from .views import Outcome, View

__all__ = ["CsvLines", "JsonLines", "TextLines"]


def _now() -> str:
    return datetime.now().astimezone().isoformat(timespec="milliseconds")


class TextLines:
    """The time, and the values; with their places where there are several items."""

    def print(self, outcomes: Sequence[Outcome]) -> None:
        several = len(outcomes) > 1
        parts = [_text(each, several) for each in outcomes]
        print(f"{_now()}  {'  '.join(parts)}", flush=True)

    def fail(self, reason: str) -> None:
        print(f"{_now()}  {reason}", flush=True)


def _text(outcome: Outcome, several: bool) -> str:
    rows, item = outcome.rows, outcome.view.item
    values = " ".join(row.text + (f" {row.unit}" if row.unit else "") for row in rows)
    values = values or f"({outcome.failure})"
    if item.point is not None:
        return f"{item.point.name}={values}"
    return f"{item.word} {item.first}: {values}" if several else values


class CsvLines:
    """
    A header, then a row for each poll: the time, a column for each value, and why there is none.

    Args:
        views: of the items; their columns are known before anything is read.

    Raises:
        ValueError: of a queue or of all readings they are not.
    """

    def __init__(self, views: Sequence[View]) -> None:
        self._titles = [title for view in views for title in view.titles()]
        self._writer = csv.writer(sys.stdout, lineterminator="\n")
        self._begun = False

    def print(self, outcomes: Sequence[Outcome]) -> None:
        cells = [cell for each in outcomes for cell in _cells(each)]
        self._write([*cells, "; ".join(each.failure for each in outcomes if each.failure)])

    def fail(self, reason: str) -> None:
        self._write([*[""] * len(self._titles), reason])

    def _write(self, cells: list[str]) -> None:
        if not self._begun:
            self._begun = True
            self._writer.writerow(["time", *self._titles, "error"])
        self._writer.writerow([_now(), *cells])
        sys.stdout.flush()


def _cells(outcome: Outcome) -> list[str]:
    return [row.plain for row in outcome.rows] or [""] * len(outcome.view.titles())


class JsonLines:
    """
    An object for each poll.

    Args:
        object_of: gives its fields.
        unit: who is asked.
    """

    def __init__(self, object_of: Callable[[Sequence[Outcome]], dict[str, Any]], unit: int) -> None:
        self._object_of = object_of
        self._unit = unit

    def print(self, outcomes: Sequence[Outcome]) -> None:
        print(json.dumps({"time": _now(), **self._object_of(outcomes)}), flush=True)

    def fail(self, reason: str) -> None:
        print(json.dumps({"time": _now(), "unit": self._unit, "error": reason}), flush=True)
