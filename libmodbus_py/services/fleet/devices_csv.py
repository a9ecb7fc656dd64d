"""
Devices in CSV: a row for each device, for fleets of thousands, as spreadsheets save them.

The headings are keys of ``[[device]]``, in any order, and ``labels.NAME``. Several items are
separated by semicolons; for an empty cell the default is used.
"""

from __future__ import annotations

import reprlib
from typing import Any

from ...protocol.mistakes import Path, inside
from ...tools.files.csv_text import CELLS, CsvRow, CsvText, number_in
from ...tools.files.schema import Keys
from ...tools.files.texts import FileError, FilePlace

__all__ = ["keys_in", "opened", "place_in"]

LABEL = "labels."


def opened(text: str, keys: Keys, kind: type[FileError]) -> CsvText:
    """Return a text as CSV; raise a FileError of a kind if it is none, or a heading is wrong."""
    columns = [key.name for key in keys.values() if key.kind in CELLS or key.name == "map"]

    def is_column(heading: str) -> bool:
        return heading in columns or heading.startswith(LABEL)

    found = CsvText(text, is_column, kind, names_first=True)
    headings = found.head.cells
    for at, heading in enumerate(headings):
        reason = ""
        if heading and not is_column(heading):
            allowed = ", ".join([*columns, f"{LABEL}NAME"])
            reason = f"no such column: {reprlib.repr(heading)}; allowed are {allowed}"
        elif heading and heading in headings[:at]:
            reason = f"two columns {heading}"
        if reason:
            raise kind((), reason, place=FilePlace(line=found.head.line))
    return found


def keys_in(text: CsvText, row: CsvRow, keys: Keys) -> dict[str, Any]:
    """Return the keys of the device in a row; raise a WrongValue with the path of a key."""
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


def place_in(text: CsvText, row: CsvRow, path: Path) -> FilePlace:
    """Return the line and the column of a key of the device in a row."""
    heading = ".".join(map(str, path[:2])) if path[:1] == ("labels",) else str(*path[:1])
    return FilePlace(line=row.line, column=heading if heading in text.head.cells else "")
