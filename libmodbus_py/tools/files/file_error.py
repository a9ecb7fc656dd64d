"""
Mistakes in files: the reason, and the place in the file.
"""

from __future__ import annotations

from typing import NamedTuple, Self

from ...protocol.mistakes import Mistake, Path, WrongValue, placed

__all__ = ["FileError", "FilePlace"]


class FilePlace(NamedTuple):
    """
    A place in a file.

    Attributes:
        file: the path of the file; empty where a text comes from no file.
        line: from 1; None for the file as a whole.
        column: the heading of a column; empty in TOML, and for a whole row.
    """

    file: str = ""
    line: int | None = None
    column: str = ""

    def __str__(self) -> str:
        line = f"line {self.line}" if self.line else ""
        column = f"column {self.column}" if self.column else ""
        return ", ".join(filter(None, (self.file, line, column)))


class FileError(WrongValue):
    """
    The content of a file is wrong.

    Attributes:
        place: the place of the mistake.
        path: the key that is wrong, such as ("unit", 0, "id").
        reason: the mistake, and the values that are allowed.
    """

    def __init__(
        self, path: str | Path, reason: str, between: str = " ", place: FilePlace | None = None
    ) -> None:
        super().__init__(path, reason, between)
        self.place: FilePlace = place or FilePlace()

    @classmethod
    def of(cls, error: Exception, place: FilePlace | None = None) -> Self:
        """Return a TypeError or ValueError as an error about a place."""
        found = placed(error, ())
        return cls(found.path, found.reason, found.between, place)

    def in_file(self, file: str) -> Self:
        """Return the same error about a place in a file."""
        return type(self)(self.path, self.reason, self.between, self.place._replace(file=file))

    def under(self, around: Path) -> Mistake:
        """Return an error about the key that names the file of this one."""
        return WrongValue.about(around, str(self))

    def __str__(self) -> str:
        place = str(self.place)
        return f"{place}: {super().__str__()}" if place else super().__str__()
