"""
A password in a file of its own, which is read again when it may have changed.
"""

from __future__ import annotations

import os
from functools import partial
from os import PathLike

from ....security.renewed import Renewed
from ....tools.files.file_error import FileError
from ....tools.files.texts import read_text

__all__ = ["SecretFile", "text_of"]


class SecretFile:
    """
    A password, read from a file.

    Args:
        path: of the file; ends of lines at its end are not part of the password.
        kind: the class of errors.

    Raises:
        FileError: of `kind`: the file cannot be read.
    """

    def __init__(self, path: str | PathLike[str], kind: type[FileError] = FileError) -> None:
        self.path: str = os.fspath(path)
        self._content = Renewed(partial(read_text, self.path, kind))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SecretFile) and self.path == other.path

    def __hash__(self) -> int:
        return hash(self.path)

    def __repr__(self) -> str:
        return f"SecretFile({self.path!r})"

    @property
    def text(self) -> str:
        """The password that the file contains now, or the former if it cannot be read."""
        return self._content.fresh().rstrip("\r\n")


def text_of(password: str | SecretFile | None) -> str | None:
    """Return a password."""
    return password.text if isinstance(password, SecretFile) else password
