"""
A line for each poll, with the time: text, CSV or JSON.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

from ...protocol.plain import time_text, without_controls
from ...tools.files.csv_text import csv_rows
from ..output import print_json
from .formatters import Formatter, ReadResult

__all__ = ["CsvPolls", "JsonPolls", "TextPolls"]


def _now() -> str:
    return time_text(time.time())


class TextPolls:
    """Prints the time and the values; with their addresses if there are several items."""

    def __init__(self, *, has_unit: bool = False) -> None:
        self._has_unit = has_unit

    def print(self, unit: int, results: Sequence[ReadResult]) -> None:
        several = len(results) > 1
        parts = [_text(each, several) for each in results]
        self._print(unit, "  ".join(parts))

    def fail(self, unit: int, reason: str) -> None:
        self._print(unit, reason)

    def _print(self, unit: int, text: str) -> None:
        whence = f"unit {unit}  " if self._has_unit else ""
        print(f"{_now()}  {whence}{text}", flush=True)


def _text(result: ReadResult, several: bool) -> str:
    rows, item = result.rows, result.formatter.item
    values = " ".join(row.text + (f" {row.unit}" if row.unit else "") for row in rows)
    values = values or f"({result.failure})"
    values += " (fell)" * result.has_fallen
    if item.point is not None:
        return f"{item.point.name}={values}"
    return f"{item.word} {item.first}: {values}" if several else values


class CsvPolls:
    """
    Prints a header, then a row for each poll: the time, the values and the error.

    Args:
        formatters: those of the items, which name the columns.
        has_unit: True for a column with the unit that was asked.

    Raises:
        ValueError: an item has no fixed number of columns.
    """

    def __init__(self, formatters: Sequence[Formatter], *, has_unit: bool = False) -> None:
        self._titles = [title for formatter in formatters for title in formatter.titles()]
        self._has_unit = has_unit
        self._begun = False

    def print(self, unit: int, results: Sequence[ReadResult]) -> None:
        cells = [cell for each in results for cell in _cells(each)]
        errors = "; ".join(filter(None, (each.failure or each.remark for each in results)))
        self._write(unit, [*cells, errors])

    def fail(self, unit: int, reason: str) -> None:
        self._write(unit, [*[""] * len(self._titles), reason])

    def _write(self, unit: int, cells: list[str]) -> None:
        if not self._begun:
            self._begun = True
            self._print(["time", *["unit"] * self._has_unit, *self._titles, "error"])
        self._print([_now(), *[str(unit)] * self._has_unit, *cells])
        sys.stdout.flush()

    def _print(self, cells: list[str]) -> None:
        text = csv_rows([cells])
        print(without_controls(text) if sys.stdout.isatty() else text, end="")


def _cells(result: ReadResult) -> list[str]:
    return [row.plain for row in result.rows] or [""] * len(result.formatter.titles())


class JsonPolls:
    """
    Prints an object for each poll of a unit.

    Args:
        object_of: returns the fields of results.
    """

    def __init__(self, object_of: Callable[[int, Sequence[ReadResult]], dict[str, Any]]) -> None:
        self._object_of = object_of

    def print(self, unit: int, results: Sequence[ReadResult]) -> None:
        print_json({"time": _now(), **self._object_of(unit, results)})

    def fail(self, unit: int, reason: str) -> None:
        print_json({"time": _now(), "unit": unit, "error": reason})
