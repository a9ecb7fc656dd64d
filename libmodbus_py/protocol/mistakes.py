"""
Errors about wrong values that contain the path of the value.

An argument, or a key of a file, is found by its path: names and 0-based indices, such as
``("route", 0, "units")``. The caller of a check adds the outer part of the path; the path becomes
text when the error is printed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any, Self

__all__ = ["Mistake", "Path", "WrongType", "WrongValue", "inside", "item", "path_text", "placed"]

Path = tuple[str | int, ...]


class Mistake(Exception):
    """
    An argument, or a key of a file, has a value that it cannot have.

    Args:
        path: path of the value; a text is the name of an argument.
        reason: the mistake, and the values that are allowed. It follows the path in the message,
            such as "must be in 0..255, not 300".
        between: stands between the path and the reason.

    Attributes:
        path, reason, between: as given.
    """

    def __init__(self, path: str | Path, reason: str, between: str = " ") -> None:
        super().__init__(path, reason, between)
        self.path: Path = (path,) if isinstance(path, str) else path
        self.reason: str = reason
        self.between: str = between

    @classmethod
    def about(cls, path: str | Path, reason: str) -> Self:
        """Return an error whose reason is a sentence of its own, such as "4 is given twice"."""
        return cls(path, reason, ": ")

    def under(self, around: Path) -> Mistake:
        """Return the same error with a longer path: `around` leads to where its path begins."""
        return type(self)((*around, *self.path), self.reason, self.between)

    def renamed(self, path: Path) -> Mistake:
        """Return the same error with `path` in place of the name that its path begins with."""
        return type(self)((*path, *self.path[1:]), self.reason, self.between)

    def __str__(self) -> str:
        return f"{path_text(self.path)}{self.between}{self.reason}" if self.path else self.reason


class WrongValue(Mistake, ValueError):
    """A `Mistake` that is a ValueError."""


class WrongType(Mistake, TypeError):
    """A `Mistake` that is a TypeError."""


def item(path: str | Path, at: int) -> Path:
    """Return the path of an item of a list."""
    return (path, at) if isinstance(path, str) else (*path, at)


def path_text(path: Path) -> str:
    """Return a path as messages have it: ``route[0].units``."""
    text = "".join(f"[{each}]" if isinstance(each, int) else f".{each}" for each in path)
    return text.removeprefix(".")


def placed(error: Exception, around: Path) -> Mistake:
    """Return a TypeError or ValueError about what lies below a path, with the whole path."""
    if isinstance(error, Mistake):
        return error.under(around)
    kind: type[Mistake] = WrongType if isinstance(error, TypeError) else WrongValue
    return kind.about(around, str(error))


@contextlib.contextmanager
def inside(*around: Any) -> Iterator[None]:
    """
    Add a path to the errors of a block.

    Raises:
        WrongType, WrongValue: the block raised a TypeError or a ValueError.
    """
    try:
        yield
    except (TypeError, ValueError) as error:
        raise placed(error, around) from None
