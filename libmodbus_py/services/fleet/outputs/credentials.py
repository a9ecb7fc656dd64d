"""
Credentials in files, which are read again when they may have changed: passwords, and the
certificate authorities that are trusted.
"""

from __future__ import annotations

import asyncio
import os
import ssl
from os import PathLike
from pathlib import Path

from ....security.describing import in_words
from ....security.renewed import Renewed, read_secret
from ....tools.files.texts import FileError, FilePlace

__all__ = ["SecretFile", "Trust", "text_of"]


class SecretFile:
    """
    A password, a token or another secret in a file, without the ends of lines at its end.

    Raises:
        FileError: of `kind`: the file cannot be read, or all users can read it.
    """

    def __init__(self, path: str | PathLike[str], kind: type[FileError] = FileError) -> None:
        self.path: str = os.fspath(path)
        self._kind = kind
        self._content = Renewed(self._read)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SecretFile) and self.path == other.path

    def __hash__(self) -> int:
        return hash(self.path)

    def __repr__(self) -> str:
        return f"SecretFile({self.path!r})"

    def _read(self) -> str:
        try:
            return read_secret(self.path)
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "it is not UTF-8"
            raise self._kind((), f"cannot read {FilePlace(self.path)}: {reason}") from None

    @property
    def text(self) -> str:
        """The password that the file contains now, or the former if it cannot be read."""
        return self._content.fresh().rstrip("\r\n")


async def text_of(password: str | SecretFile | None) -> str | None:
    """Return a password; a file is read in a thread."""
    if isinstance(password, SecretFile):
        return await asyncio.to_thread(lambda: password.text)
    return password


class Trust:
    """
    The certificate authorities that an output trusts: those in a file, or those of the system.
    """

    def __init__(self, ca: str | None, sockets: type[ssl.SSLSocket] = ssl.SSLSocket) -> None:
        self._ca = ca
        self._sockets = sockets
        self._made: Renewed[ssl.SSLContext] | None = None

    async def context(self) -> ssl.SSLContext:
        """
        Return the context of TLS, or raise OSError; a file is read again each time, in a thread.
        """
        if self._made is None:
            self._made = await asyncio.to_thread(Renewed, self._read)
            return self._made.value
        return await asyncio.to_thread(self._made.fresh)

    def _read(self) -> ssl.SSLContext:
        if self._ca is not None and not Path(self._ca).is_file():
            raise OSError(f"ca: there is no file {self._ca!r}")
        try:
            context = ssl.create_default_context(cafile=self._ca)
        except ssl.SSLError as error:
            reason = f"ca: {self._ca!r} contains no certificate: {in_words(error)}"
            raise OSError(reason) from None
        context.sslsocket_class = self._sockets
        return context
