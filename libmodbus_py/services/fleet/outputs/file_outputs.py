"""
Outputs to files: lines of JSON, and rows of CSV.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from ....protocol.mistakes import WrongType, WrongValue
from ....tools.files.csv_text import csv_rows
from ..buffer import MOST_KEPT
from .forms import COLUMNS, as_csv, as_json
from .line_file import Format, LineFile

__all__ = ["CsvOutput", "JsonOutput"]


class JsonOutput(LineFile):
    """
    Appends readings to a file: device, name, time (ISO 8601, UTC), value, unit, quality, and
    the reason if there is no value, and the labels of the device if it has any.

    Args:
        path: the path of the file; "-" for the standard output. The fleet ends when the standard
            output is closed.
        buffer: the most readings that wait for the file; the oldest are dropped beyond.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    def __init__(self, path: str = "-", buffer: int = MOST_KEPT) -> None:
        super().__init__(path, Format("json", as_json, b'{"device": '), buffer)


class CsvOutput(LineFile):
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
        self, path: str = "-", buffer: int = MOST_KEPT, labels: Sequence[str] = ()
    ) -> None:
        columns = _columns(labels)
        header = csv_rows([(*COLUMNS, *columns)]).encode()
        lines = partial(as_csv, labels=columns)
        super().__init__(path, Format("csv", lines, header, has_header=True, quote=b'"'), buffer)


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
