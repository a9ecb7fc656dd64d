"""
Devices in CSV: a row for each device, for fleets of thousands.

The headings are keys of ``[[device]]``, in any order, and ``labels.NAME``. Several items are
separated by semicolons; for an empty cell the default is used.
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterator
from typing import Any, NamedTuple

from ...protocol.mistakes import Path, WrongValue, inside
from ...tools.files.csv_text import CELLS, CsvText
from ...tools.files.schema import Keys
from ...tools.files.texts import FileError, FilePlace

__all__ = ["DeviceRow", "device_rows"]

LABEL = "labels."


class DeviceRow(NamedTuple):
    """
    A row of a file: the keys of the device, the line number from 1, and the headings of all
    columns.
    """

    keys: dict[str, Any]
    line: int
    headings: list[str]

    def place(self, path: Path) -> FilePlace:
        """Return the line and the column of a key."""
        heading = ".".join(map(str, path[:2])) if path[:1] == ("labels",) else str(*path[:1])
        return FilePlace(line=self.line, column=heading if heading in self.headings else "")


def device_rows(text: str, keys: Keys, kind: type[FileError]) -> Iterator[DeviceRow]:
    """
    Yield the rows, with the keys of the device of each.

    Raises:
        FileError: of class `kind`: the text is not CSV, or a row contains a mistake.
    """
    columns = [key.name for key in keys.values() if key.kind in CELLS or key.name == "map"]
    opened = CsvText(text, lambda heading: _is_column(heading, columns), kind, names_first=True)
    headings = opened.head.cells
    try:
        _check(headings, columns)
    except ValueError as error:
        raise kind.of(error, FilePlace(line=opened.head.line)) from None
    for row in opened.rows():
        found = DeviceRow({}, row.line, headings)
        try:
            _read(found.keys, opened.cells(row), headings, keys)
        except (TypeError, ValueError) as error:
            path = getattr(error, "path", ())
            raise kind.of(error, found.place(path)) from None
        yield found


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


def _read(found: dict[str, Any], cells: list[str], headings: list[str], keys: Keys) -> None:
    for heading, cell in zip(headings, cells, strict=False):
        if not (heading and cell):
            continue
        if heading.startswith(LABEL):
            found.setdefault("labels", {})[heading.removeprefix(LABEL)] = cell
            continue
        with inside(heading):
            found[heading] = CELLS.get(keys[heading].kind, str)(cell)
