"""
A row of CSV for each reading.
"""

from __future__ import annotations

from ..buffer import MOST_KEPT
from .forms import COLUMNS, as_csv
from .text_file import TextFile

__all__ = ["CsvOutput"]

HEADER = f"{','.join(COLUMNS)}\n".encode()


class CsvOutput(TextFile):
    """
    Appends readings to a file; the first line of a new file contains the names of the columns.

    Args:
        path, buffer, rotate, keep: as for `JsonOutput`.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range, or `rotate` for the
            standard output.
    """

    def __init__(
        self,
        path: str = "-",
        buffer: int = MOST_KEPT,
        rotate: str | None = None,
        keep: int | None = None,
    ) -> None:
        super().__init__("csv", path, as_csv, HEADER, buffer, rotate, keep, quote=b'"')
