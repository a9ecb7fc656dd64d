"""
A line for each poll, with the time: text, CSV or JSON.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Any

from ...protocol.plain import without_controls
from ...tools.files.csv_text import csv_rows
from ..output import print_json
from .formatters import Formatter, ReadResult

__all__ = ["CsvPolls", "JsonPolls", "TextPolls"]


def _now() -> str:
    return datetime.now().astimezone().isoformat(timespec="milliseconds")


class TextPolls:
    """Prints the time and the values; with their addresses if there are several items."""

    def print(self, results: Sequence[ReadResult]) -> None:
        several = len(results) > 1
        parts = [_text(each, several) for each in results]
        print(f"{_now()}  {'  '.join(parts)}", flush=True)

    def fail(self, reason: str) -> None:
        print(f"{_now()}  {reason}", flush=True)


def _text(result: ReadResult, several: bool) -> str:
    rows, item = result.rows, result.formatter.item
    values = " ".join(row.text + (f" {row.unit}" if row.unit else "") for row in rows)
    values = values or f"({result.failure})"
    if item.point is not None:
        return f"{item.point.name}={values}"
    return f"{item.word} {item.first}: {values}" if several else values


class CsvPolls:
    """
    Prints a header, then a row for each poll: the time, the values and the error.

    Args:
        formatters: those of the items, which name the columns.

    Raises:
        ValueError: an item has no fixed number of columns.
    """

    def __init__(self, formatters: Sequence[Formatter]) -> None:
        self._titles = [title for formatter in formatters for title in formatter.titles()]
        self._begun = False

    def print(self, results: Sequence[ReadResult]) -> None:
        cells = [cell for each in results for cell in _cells(each)]
        self._write(
            [*cells, "; ".join(filter(None, (each.failure or each.remark for each in results)))]
        )

    def fail(self, reason: str) -> None:
        self._write([*[""] * len(self._titles), reason])

    def _write(self, cells: list[str]) -> None:
        if not self._begun:
            self._begun = True
            self._print(["time", *self._titles, "error"])
        self._print([_now(), *cells])
        sys.stdout.flush()

    def _print(self, cells: list[str]) -> None:
        text = csv_rows([cells])
        print(without_controls(text) if sys.stdout.isatty() else text, end="")


def _cells(result: ReadResult) -> list[str]:
    return [row.plain for row in result.rows] or [""] * len(result.formatter.titles())


class JsonPolls:
    """
    Prints an object for each poll.

    Args:
        object_of: returns the fields of results.
        unit: the unit that is asked.
    """

    def __init__(
        self, object_of: Callable[[Sequence[ReadResult]], dict[str, Any]], unit: int
    ) -> None:
        self._object_of = object_of
        self._unit = unit

    def print(self, results: Sequence[ReadResult]) -> None:
        print_json({"time": _now(), **self._object_of(results)})

    def fail(self, reason: str) -> None:
        print_json({"time": _now(), "unit": self._unit, "error": reason})
