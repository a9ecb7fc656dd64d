"""
Devices in CSV: a line for each, for fleets of thousands.

The first line names the columns: keys of ``[[device]]``, in any order, and ``labels.NAME``.
Several items are separated by semicolons; a cell that is empty is not there. Cells are
separated by commas, or by semicolons or tabs if the first line has these.
"""

from __future__ import annotations

import csv
import io
import reprlib
from collections.abc import Callable, Iterator
from typing import Any

__all__ = ["COLUMNS", "rows"]

MOST_DEVICES = 100_000


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"must be a number such as 0.5, not {reprlib.repr(text)}") from None


def _integer(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= 9):
        raise ValueError(f"must be a whole number, not {reprlib.repr(text)}")
    return int(text)


def _flag(text: str) -> bool:
    if text.lower() not in ("true", "false"):
        raise ValueError(f"must be true or false, not {reprlib.repr(text)}")
    return text.lower() == "true"


def _items(text: str) -> list[str]:
    return [each.strip() for each in text.split(";") if each.strip()]


COLUMNS: dict[str, Callable[[str], Any]] = {
    "name": str,
    "url": str,
    "unit": _integer,
    "map": str,
    "items": _items,
    "gap": _integer,
    "max_registers": _integer,
    "interval": _number,
    "timeout": _number,
    "spacing": _number,
    "on_change": _flag,
    "zone": str,
}
"""Key -> what makes it of a cell."""


def rows(text: str) -> Iterator[tuple[int, dict[str, Any]]]:
    """
    Give the line of each device, and its keys.

    Raises:
        ValueError: what is wrong, beginning with its line.
    """
    found = _lines(text.removeprefix("\ufeff"))
    headings: list[str] = []
    for count, (line, cells) in enumerate(found):
        if not headings:
            headings = _headings(line, cells)
        elif count > MOST_DEVICES:
            raise ValueError(f"line {line}: more than {MOST_DEVICES} devices")
        else:
            yield line, _keys(line, headings, cells)


def _lines(text: str) -> Iterator[tuple[int, list[str]]]:
    first = next((line for line in text.splitlines() if _says(line)), "")
    delimiter = max(",;\t", key=first.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    line = 1
    while True:
        try:
            cells = next(reader, None)
        except csv.Error as error:
            raise ValueError(f"line {line}: no CSV: {error}") from None
        if cells is None:
            return
        if cells and _says(cells[0] or "".join(cells)):
            yield line, [cell.strip() for cell in cells]
        line = reader.line_num + 1


def _says(text: str) -> bool:
    """Whether it is neither empty nor a comment."""
    return bool(text.strip()) and not text.lstrip().startswith("#")


def _headings(line: int, cells: list[str]) -> list[str]:
    for at, heading in enumerate(cells):
        if heading not in COLUMNS and not heading.startswith("labels."):
            allowed = ", ".join([*COLUMNS, "labels.NAME"])
            raise ValueError(
                f"line {line}: no such column: {reprlib.repr(heading)}; allowed are {allowed}"
            )
        if heading in cells[:at]:
            raise ValueError(f"line {line}: two columns {heading}")
    return cells


def _keys(line: int, headings: list[str], cells: list[str]) -> dict[str, Any]:
    if len(cells) > len(headings):
        raise ValueError(f"line {line}: {len(cells)} cells, but only {len(headings)} columns")
    keys: dict[str, Any] = {}
    labels: dict[str, str] = {}
    for heading, cell in zip(headings, cells, strict=False):
        if not cell:
            continue
        if heading.startswith("labels."):
            labels[heading.removeprefix("labels.")] = cell
            continue
        try:
            keys[heading] = COLUMNS[heading](cell)
        except ValueError as error:
            raise ValueError(f"line {line}, column {heading}: {error}") from None
    return {**keys, "labels": labels} if labels else keys
