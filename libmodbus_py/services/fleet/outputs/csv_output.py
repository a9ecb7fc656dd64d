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
        path, buffer: as for `JsonOutput`.

    Raises:
        TypeError: `path` is not text.
    """

    def __init__(self, path: str = "-", buffer: int = MOST_KEPT) -> None:
        super().__init__("csv", path, as_csv, HEADER, buffer, quote=b'"')
