"""
Register maps in CSV, as vendors give them.

The first line that is neither empty nor begins with ``#`` names the columns, in any order, by
`words.COLUMNS`. Cells are separated by commas, semicolons, tabs or bars; one that is empty says
nothing. Where no column tells the table, addresses are references, such as 40123.
"""

from __future__ import annotations

import csv
import io
import re
import reprlib
from collections.abc import Iterator
from typing import Any, NamedTuple

from ....protocol.values import parse_reference
from .cells import READERS
from .drafts import MAX_POINTS, Draft, Mistake
from .words import COLUMNS, DOUBTFUL_COLUMNS, plain

__all__ = ["Columns", "drafts", "header"]

DELIMITERS = ",;\t|"

# A heading is a few words; the rest would only fill messages.
MAX_HEADING = 60

# What editors and terminals obey, and no table holds.
_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")


class Columns(NamedTuple):
    """
    What the first line of a file says.

    Attributes:
        delimiter: between cells.
        width: how many there are.
        places: what a column holds -> (its index, its heading).
        ignored: headings that mean nothing here.
    """

    delimiter: str
    width: int
    places: dict[str, tuple[int, str]]
    ignored: list[str]


class Row(NamedTuple):
    """A line with something in it: its number, and its cells with single spaces."""

    line: int
    cells: list[str]


def header(text: str) -> Columns | Mistake:
    """Find the columns; or there are none, or two for the same, or one that means anything."""
    if found := _CONTROL.search(text):
        line = text.count("\n", 0, found.start()) + 1
        return Mistake(f"line {line}", f"no text: it has a character {ord(found[0]):#04x}")
    rows = [(delimiter, _first_row(text, delimiter)) for delimiter in DELIMITERS]
    delimiter, row = max(rows, key=lambda each: _known(each[1]))
    return row if isinstance(row, Mistake) else _columns(delimiter, row)


def drafts(text: str, columns: Columns) -> Iterator[Draft | Mistake]:
    """Give what each line says of a point, or what is wrong with it."""
    rows = _rows(text, columns.delimiter)
    next(rows)
    for count, row in enumerate(rows):
        if isinstance(row, Mistake):
            yield row
        elif count == MAX_POINTS:
            yield Mistake(f"line {row.line}", f"more than {MAX_POINTS} points")
            return
        elif any(row.cells[at : at + 1] != [""] for at, _ in columns.places.values()):
            yield _draft(row, columns)


def _rows(text: str, delimiter: str) -> Iterator[Row | Mistake]:
    # Excel begins a file with a mark of order.
    lines = io.StringIO(text.removeprefix("\ufeff"), newline="")
    reader = csv.reader(lines, delimiter=delimiter, strict=True)
    line = 1
    while True:
        try:
            cells = next(reader, None)
        except csv.Error as error:
            yield Mistake(f"line {line}", f"no CSV: {error}")
            return
        if cells is None:
            return
        single = [" ".join(cell.split()) for cell in cells]
        if any(single) and not single[0].startswith("#"):
            yield Row(line, single)
        line = reader.line_num + 1


# --- columns ---------------------------------------------------------------------------


def _first_row(text: str, delimiter: str) -> Row | Mistake:
    return next(_rows(text, delimiter), Row(1, []))


def _known(row: Row | Mistake) -> int:
    """How many of its cells are headings."""
    if isinstance(row, Mistake):
        return -1
    return sum(plain(heading) in COLUMNS for heading in row.cells)


def _columns(delimiter: str, row: Row) -> Columns | Mistake:
    place = f"line {row.line}"
    columns = Columns(delimiter, len(row.cells), {}, [])
    headings = [(at, heading[:MAX_HEADING]) for at, heading in enumerate(row.cells) if heading]
    for at, heading in sorted(headings, key=_rank):
        if doubt := DOUBTFUL_COLUMNS.get(plain(heading)):
            return Mistake(place, f"column {heading} means this or that: call it {doubt}")
        meaning = COLUMNS.get(plain(heading))
        other = columns.places.get(meaning or "")
        is_more = meaning == "description" or (other and _rank(other) < _rank((at, heading)))
        if meaning is None or (other and is_more):
            columns.ignored.append(heading)
        elif other:
            return Mistake(place, f"columns {other[1]} and {heading} both hold the {meaning}")
        else:
            columns.places[meaning] = at, heading
    for key in ("name", "address"):
        if key not in columns.places:
            known = ", ".join(word for word, meaning in COLUMNS.items() if meaning == key)
            return Mistake(place, f"no column {key}; it may be called {known}")
    return columns


def _rank(column: tuple[int, str]) -> bool:
    """Words that are keys themselves go before others."""
    return plain(column[1]) not in READERS


# --- points ----------------------------------------------------------------------------


def _draft(row: Row, columns: Columns) -> Draft | Mistake:
    def place(key: str | None) -> str:
        at = columns.places.get(key or "")
        return f"line {row.line}, column {at[1]}" if at else f"line {row.line}"

    if any(row.cells[columns.width :]):
        message = f"{len(row.cells)} cells below {columns.width} headings: quote what has a"
        return Mistake(place(None), f"{message} {columns.delimiter!r} in it")
    cells = {key: row.cells[at] for key, (at, _) in columns.places.items() if at < len(row.cells)}
    given = {key: cell for key, cell in cells.items() if cell}
    keys: dict[str, Any] = {}
    for key, cell in given.items():
        try:
            keys[key] = READERS[key](cell)
        except ValueError as error:
            return Mistake(place(key), f"{key} {error}")
    try:
        return Draft(_settled(keys, given), place)
    except ValueError as error:
        return Mistake(place(str(error).partition(" ")[0]), str(error))


def _settled(keys: dict[str, Any], given: dict[str, str]) -> dict[str, Any]:
    """
    Settle what several columns say together.

    Raises:
        ValueError: they contradict each other; it begins with the column that is wrong.
    """
    table = keys.pop("function", None)
    if table and keys.setdefault("table", table) != table:
        raise ValueError(f"function {given['function']} is none of {keys['table']}")
    if "address" in keys and "table" not in keys:
        keys["table"], keys["address"] = _referred(given["address"])
    if "divisor" in given:
        if "scale" in given:
            raise ValueError("divisor must not stand beside a scale")
        if not keys["divisor"]:
            raise ValueError("divisor must not be 0")
        keys["scale"] = 1 / keys["divisor"]
    keys.pop("divisor", None)
    if keys.get("type") == "bool":
        if keys.get("table", "").endswith("registers"):
            raise ValueError("type of registers must not be bool; bits16 gives those of one")
        del keys["type"]
    return keys


def _referred(text: str) -> tuple[str, int]:
    try:
        table, address = parse_reference(text)
    except ValueError:
        raise ValueError(
            "address must be a reference such as 40123 or 300007 where no column says the table,"
            f" not {reprlib.repr(text)}"
        ) from None
    return table, address
