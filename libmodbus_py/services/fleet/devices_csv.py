"""
Devices in CSV: a row for each device, for fleets of thousands, as spreadsheets save them.

The headings are keys of ``[[device]]``, in any order, and ``labels.NAME``. Several items are
separated by semicolons; for an empty cell the default is used.
"""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

from ...protocol.mistakes import Path, WrongValue, inside
from ...tools.files.csv_text import CELLS, CsvRow, CsvText, number_in
from ...tools.files.schema import Keys
from ...tools.files.texts import FileError, FilePlace

__all__ = ["DeviceRow", "device_rows", "opened"]

LABEL = "labels."


class DeviceRow(NamedTuple):
    """
    A row of a file.

    Attributes:
        keys: returns the keys of the device; raises a TypeError or ValueError with the path of the
            key if the row contains a mistake.
        line: the line number in the file, from 1.
        headings: the headings of all columns.
    """

    keys: Callable[[], dict[str, Any]]
    line: int
    headings: list[str]

    def place(self, path: Path) -> FilePlace:
        """Return the line and the column of a key."""
        heading = ".".join(map(str, path[:2])) if path[:1] == ("labels",) else str(*path[:1])
        return FilePlace(line=self.line, column=heading if heading in self.headings else "")


def opened(text: str, keys: Keys, kind: type[FileError]) -> CsvText:
    """
    Return a text as CSV with headings.

    Raises:
        FileError: of class `kind`: the text is not CSV, or a heading is wrong.
    """
    columns = [key.name for key in keys.values() if key.kind in CELLS or key.name == "map"]
    found = CsvText(text, lambda heading: _is_column(heading, columns), kind, names_first=True)
    try:
        _check(found.head.cells, columns)
    except ValueError as error:
        raise kind.of(error, FilePlace(line=found.head.line)) from None
    return found


def device_rows(text: CsvText, keys: Keys, kind: type[FileError]) -> Iterator[DeviceRow]:
    """
    Yield the rows below the headings.

    Args:
        text, keys, kind: as `opened` returns and takes them.

    Raises:
        FileError: of class `kind`: the rest of the text is not CSV.
    """
    headings = text.head.cells
    for row in text.rows():
        yield DeviceRow(partial(_keys, text, row, keys), row.line, headings)


def _is_column(heading: str, columns: list[str]) -> bool:
    return heading in columns or heading.startswith(LABEL)


def _check(headings: list[str], columns: list[str]) -> None:
    for at, heading in enumerate(headings):
        if heading and not _is_column(heading, columns):
            allowed = ", ".join([*columns, f"{LABEL}NAME"])
            reason = f"no such column: {reprlib.repr(heading)}; allowed are {allowed}"
            raise WrongValue((), reason)
        if heading and heading in headings[:at]:
            raise WrongValue((), f"two columns {heading}")


def _keys(text: CsvText, row: CsvRow, keys: Keys) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for heading, cell in zip(text.head.cells, text.cells(row), strict=False):
        if not (heading and cell):
            continue
        if heading.startswith(LABEL):
            found.setdefault("labels", {})[heading.removeprefix(LABEL)] = cell
            continue
        with inside(heading):
            read = CELLS.get(keys[heading].kind, str)
            found[heading] = read(text.number_cell(cell) if read is number_in else cell)
    return found
