"""
The text of a file with credentials, which is read again for each connection.
"""

from __future__ import annotations

from collections import UserString
from typing import Any

from ...security.renewed import Renewed

__all__ = ["FileText"]

LONGEST = 1 << 16


class FileText(UserString):
    """
    A text that nats-py takes for credentials, as often as it needs them.

    nats-py itself would read a file without credentials for ever, while nothing else runs.

    Args:
        name: of the variable that names the file, for errors.
        path: of the file.
        needed: what the text must contain.

    Raises:
        ValueError: the file cannot be read, or does not contain one of these.
    """

    def __init__(self, name: str, path: str, *needed: str) -> None:
        self._name = name
        self._path = path
        self._needed = needed
        self._content = Renewed(self._read)

    def _read(self) -> str:
        try:
            with open(self._path, encoding="utf-8") as file:
                text = file.read(LONGEST)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise ValueError(f"{self._name}: {self._path}: {reason}") from None
        for each in self._needed:
            if each not in text:
                raise ValueError(f"{self._name}: {self._path}: contains no {each!r}")
        return text

    @property
    def data(self) -> str:  # type: ignore[override]
        """The text that the file contains now, or the former if it is wrong."""
        return self._content.fresh()

    def strip(self, chars: str | None = None) -> Any:
        """Return the text without spaces at its ends, or without these characters."""
        return UserString(self.data.strip(chars))
