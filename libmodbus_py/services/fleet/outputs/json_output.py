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
    Appends readings to a file: time (ISO 8601, UTC), device, name, value, unit, quality, and
    the reason where there is no value.

    Args:
        path: of the file; "-" for the standard output, whose end is that of the fleet.
        buffer: readings that wait for it, at most; then the oldest are dropped.

    Raises:
        TypeError: `path` is no text.
    """

    def __init__(self, path: str = "-", buffer: int = MOST_KEPT) -> None:
        super().__init__("json", path, as_json, buffer=buffer)
