"""
A file in TOML, and what is made of it; every mistake is told with its line.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from os import PathLike
from typing import TypeVar

from .toml_lines import line_of, path_at_start
from .toml_text import MAX_SIZE

__all__ = ["load_file", "read_text"]

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
    text = read_text(path, kind)
    try:
        return parse(text)
    except kind as error:
        line = line_of(text, path_at_start(str(error)))
        place = f"{path}, line {line}" if line else path
        raise kind(f"{place}: {error}") from None


def read_text(path: str | PathLike[str], kind: type[ValueError], most: int = MAX_SIZE) -> str:
    """
    Read a text of at most so many bytes.

    Raises:
        ValueError: of `kind`: it cannot be read, is no regular file, is longer, or no UTF-8; with
            the file.
    """
    try:
        with open(path, "rb", opener=_at_once) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise kind(f"{path}: no regular file")
            data = file.read(most + 1)
        if len(data) > most:
            raise kind(f"{path}: more than {most} bytes")
        return data.decode("utf-8")
    except OSError as error:
        raise kind(f"cannot read {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise kind(f"{path}: byte {error.start} is no UTF-8") from None


def _at_once(path: str, flags: int) -> int:
    """A named pipe would be waited for, for as long as nobody writes into it."""
    return os.open(path, flags | os.O_NONBLOCK)
