"""
Reading files: a text within bounds, and a TOML document.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from os import PathLike, fspath
from typing import TypeVar

from ...protocol.mistakes import placed
from .file_error import FileError, FilePlace
from .toml_lines import line_of
from .toml_text import MAX_SIZE

__all__ = ["load_file", "read_text"]

Made = TypeVar("Made")


def load_file(
    path: str | PathLike[str], parse: Callable[[str], Made], kind: type[FileError]
) -> Made:
    """
    Read a file in TOML and return its parsed content.

    Args:
        parse: returns the content of a text; raises TypeErrors and ValueErrors, with the path of
            the key.

    Raises:
        FileError: of `kind`: the file cannot be read, or `parse` raised an error, with the file
            and the line.
    """
    text = read_text(path, kind)
    try:
        return parse(text)
    except (TypeError, ValueError) as error:
        mistake = placed(error, ())
        raise kind.of(mistake, FilePlace(fspath(path), line_of(text, mistake.path))) from None


def read_text(path: str | PathLike[str], kind: type[FileError], most: int = MAX_SIZE) -> str:
    """
    Read a text of at most a number of bytes.

    Raises:
        FileError: of `kind`: the file cannot be read, is longer, or not a regular file or UTF-8.
    """
    place = FilePlace(fspath(path))
    try:
        with open(path, "rb", opener=_at_once) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise kind((), "not a regular file", place=place)
            data = file.read(most + 1)
        if len(data) > most:
            raise kind((), f"more than {most} bytes", place=place)
        return data.decode("utf-8")
    except OSError as error:
        raise kind((), f"cannot read {place}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise kind((), f"byte {error.start} is not UTF-8", place=place) from None


def _at_once(path: str, flags: int) -> int:
    """Open a named pipe without waiting for a writer."""
    return os.open(path, flags | os.O_NONBLOCK)
