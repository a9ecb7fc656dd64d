"""
A row of CSV for each reading.
"""

from __future__ import annotations

from collections.abc import Sequence

from ....protocol.mistakes import WrongType, WrongValue
from ....tools.files.csv_text import csv_rows
from ..buffer import MOST_KEPT
from ..readings import Reading
from .forms import COLUMNS, as_csv
from .text_file import TextFile

__all__ = ["CsvOutput"]

HEADER = f"{','.join(COLUMNS)}\n".encode()
"""The first line without labels."""


class CsvOutput(TextFile):
    """
    Appends readings to a file; the first line of a new file contains the names of the columns.

    Args:
        path, buffer: as for `JsonOutput`.
        labels: names of labels of devices, each of which is a column behind the others; empty
            for devices that lack the label.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    def __init__(
        self,
        path: str = "-",
        buffer: int = MOST_KEPT,
        labels: Sequence[str] = (),
    ) -> None:
        columns = _columns(labels)
        header = csv_rows([(*COLUMNS, *columns)]).encode() if columns else HEADER
        super().__init__("csv", path, self._rows, header, buffer, quote=b'"')
        self._columns = columns

    def _rows(self, readings: Sequence[Reading]) -> bytes:
        return as_csv(readings, self._columns)


def _columns(labels: object) -> list[str]:
    """Return the names of the columns for labels."""
    if isinstance(labels, str) or not isinstance(labels, Sequence):
        raise WrongType("labels", f"must be a list of names, not {labels!r}")
    for at, name in enumerate(labels):
        if not isinstance(name, str) or not name:
            raise WrongType(("labels", at), f"must be text, not {name!r}")
        if name in COLUMNS or name in labels[:at]:
            raise WrongValue.about(("labels", at), f"there is a column {name!r} already")
    return [*labels]
