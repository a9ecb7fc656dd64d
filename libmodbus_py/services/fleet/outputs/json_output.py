"""
A line of JSON for each reading.
"""

from __future__ import annotations

from ..buffer import MOST_KEPT
from .forms import as_json
from .text_file import TextFile

__all__ = ["JsonOutput"]


class JsonOutput(TextFile):
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

    def __init__(
        self,
        path: str = "-",
        buffer: int = MOST_KEPT,
    ) -> None:
        super().__init__("json", path, as_json, b"", buffer)
