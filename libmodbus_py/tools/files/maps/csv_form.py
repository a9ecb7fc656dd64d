"""
Register maps in CSV, as vendors publish them.

The headings name the columns, in any order, by `words.COLUMNS`. Empty cells are
ignored. Without a column for the table, addresses are references, such as 40123.
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterator
from typing import Any, NamedTuple

from ....protocol.mistakes import Path, WrongValue, inside
from ....protocol.values import parse_reference
from ....protocol.words import plain
from ..csv_text import CsvRow, CsvText
from ..file_error import FilePlace
from .cells import READERS
from .drafts import MAX_POINTS, Draft, MapError
from .words import COLUMNS, DOUBTFUL_COLUMNS

__all__ = ["Columns", "columns_of", "drafts", "opened"]

# A heading is a few words; the rest would only fill messages.
MAX_HEADING = 60


class Columns(NamedTuple):
    """
    The columns of a file, found by their headings.

    Attributes:
        places: kind of a column -> (its index, its heading).
        ignored: headings without a known meaning.
    """

    places: dict[str, tuple[int, str]]
    ignored: list[str]


def opened(text: str) -> CsvText:
    """
    Return a text as CSV with headings.

    Raises:
        MapError: the text is not CSV.
    """
    return CsvText(text, lambda heading: plain(heading) in COLUMNS, MapError)


def columns_of(head: CsvRow) -> Columns:
    """
    Return the columns by their kinds.

    Raises:
        MapError: a column is missing, two are of one kind, or a heading is ambiguous.
    """
    place = FilePlace(line=head.line)
    columns = Columns({}, [])
    single = [" ".join(cell.split()) for cell in head.cells]
    headings = [(at, heading[:MAX_HEADING]) for at, heading in enumerate(single) if heading]
    for at, heading in sorted(headings, key=_rank):
        if doubt := DOUBTFUL_COLUMNS.get(plain(heading)):
            reason = f"column {heading} means this or that: call it {doubt}"
            raise MapError((), reason, place=place)
        meaning = COLUMNS.get(plain(heading))
        other = columns.places.get(meaning or "")
        is_more = meaning == "description" or (other and _rank(other) < _rank((at, heading)))
        if meaning is None or (other and is_more):
            columns.ignored.append(heading)
        elif other:
            reason = f"columns {other[1]} and {heading} both hold the {meaning}"
            raise MapError((), reason, place=place)
        else:
            columns.places[meaning] = at, heading
    for key in ("name", "address"):
        if key not in columns.places:
            known = ", ".join(word for word, meaning in COLUMNS.items() if meaning == key)
            raise MapError((), f"no column {key}; it may be called {known}", place=place)
    return columns


def _rank(column: tuple[int, str]) -> bool:
    """Return the rank of a heading: names of keys come before other words."""
    return plain(column[1]) not in READERS


def drafts(text: CsvText, columns: Columns) -> Iterator[Draft]:
    """
    Yield the point of each row as a draft.

    Raises:
        MapError: the rest of the text is not CSV, or there are too many rows.
    """
    for count, row in enumerate(text.rows()):
        if count == MAX_POINTS:
            raise MapError((), f"more than {MAX_POINTS} points", place=FilePlace(line=row.line))
        if any(row.cells[at : at + 1] != [""] for at, _ in columns.places.values()):
            yield _draft(text, columns, row)


def _draft(text: CsvText, columns: Columns, row: CsvRow) -> Draft:
    def place(path: Path) -> FilePlace:
        _, heading = columns.places.get(str(path[0]) if path else "", (0, ""))
        return FilePlace(line=row.line, column=heading)

    def keys() -> dict[str, Any]:
        cells = [" ".join(cell.split()) for cell in text.cells(row)]
        held = {key: cells[at] for key, (at, _) in columns.places.items() if at < len(cells)}
        given = {key: cell for key, cell in held.items() if cell}
        found = {}
        for key, cell in given.items():
            with inside(key):
                found[key] = READERS[key](cell)
        return _settled(found, given)

    return Draft((), place, keys)


def _settled(keys: dict[str, Any], given: dict[str, str]) -> dict[str, Any]:
    """
    Resolve arguments that depend on several columns.

    Raises:
        WrongValue: they contradict each other.
    """
    table = keys.pop("function", None)
    if table and keys.setdefault("table", table) != table:
        raise WrongValue("function", f"{given['function']} is none of {keys['table']}")
    if "address" in keys and "table" not in keys:
        keys["table"], keys["address"] = _referred(given["address"])
    if "divisor" in given:
        if "scale" in given:
            raise WrongValue("divisor", "cannot be given together with a scale")
        if not keys["divisor"]:
            raise WrongValue("divisor", "must not be 0")
        keys["scale"] = 1 / keys["divisor"]
    keys.pop("divisor", None)
    if keys.get("missing") == "sunspec" and plain(given.get("type", "")).startswith("acc"):
        keys["missing"] = [0]  # of accumulators, 0 means "not implemented"
    if keys.get("type") == "bool":
        if keys.get("table", "").endswith("registers"):
            reason = "of registers must not be bool; bits16 gives those of one"
            raise WrongValue("type", reason)
        del keys["type"]
    return keys


def _referred(text: str) -> tuple[str, int]:
    try:
        table, address = parse_reference(text)
    except ValueError:
        wanted = "a reference such as 40123 or 300007 where no column says the table"
        raise WrongValue("address", f"must be {wanted}, not {reprlib.repr(text)}") from None
    return table, address
