"""
A file in TOML, and what is made of it; every mistake is told with its line.
"""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from typing import TypeVar

from .bounded import MAX_SIZE
from .lines import line_of, path_at_start

__all__ = ["load_file"]

Made = TypeVar("Made")


def load_file(
    path: str | PathLike[str], parse: Callable[[str], Made], kind: type[ValueError]
) -> Made:
    """
    Read a file and make something of its text.

    Args:
        parse: raises errors of `kind`, which begin with the key that they are about.

    Raises:
        ValueError: of `kind`: it cannot be read, or `parse` raised it; with file and line.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(MAX_SIZE + 1)
        if len(data) > MAX_SIZE:
            raise kind(f"{path}: more than {MAX_SIZE} bytes")
        text = data.decode("utf-8")
    except OSError as error:
        raise kind(f"cannot read {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise kind(f"{path}: byte {error.start} is no UTF-8") from None
    try:
        return parse(text)
    except kind as error:
        line = line_of(text, path_at_start(str(error)))
        place = f"{path}, line {line}" if line else path
        raise kind(f"{place}: {error}") from None
