"""
Servers of other software, such as brokers, databases and NATS: their URLs, and credentials in
files, which are read again when they may have changed.

No URL contains a user, a password or a token: URLs are logged and shown in lists of processes. Each
server has settings for these, of which one names a file.
"""

from __future__ import annotations

import asyncio
import os
import ssl
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

from ..files.texts import FileError, FilePlace
from ..ports.hosts import host_and_port
from ..protocol.mistakes import WrongType, WrongValue
from ..security.certificates import in_words
from ..security.security import RenewedValue, read_secret


class ServerUrl(NamedTuple):
    """The parts of the URL of a server, in lower case; an IPv6 address has no brackets."""

    scheme: str
    host: str
    port: int

    @property
    def place(self) -> str:
        """Host and port, equal for all spellings of the same host and port."""
        return host_and_port(self.host, self.port)


def server_url(
    key: str,
    value: object,
    ports: Mapping[str, int],
    *,
    example: str,
    login: str,
    may_have_path: bool = False,
) -> ServerUrl:
    """
    Read the URL of a server, the setting `key`; `ports` are those of the allowed schemes. Errors
    name an example and the settings for a login, and repeat no login that the URL contains.
    """
    if not isinstance(value, str):
        raise WrongType(key, f"must be text, not {type(value).__name__}")
    if "@" in value:
        raise WrongValue(key, f"must not contain a user or password: use {login}")
    text = value.partition("?")[0]  # a query may contain a token
    wrong = WrongValue(key, f'must be a URL such as "{example}", not {text!r}')
    try:
        parts = urlsplit(value)
    except ValueError:  # such as brackets without an address
        raise wrong from None
    is_plain = value.isascii() and value.isprintable() and " " not in value
    if parts.scheme not in ports or not parts.hostname or not is_plain:
        raise wrong
    if parts.query or parts.fragment or (parts.path not in ("", "/") and not may_have_path):
        raise wrong
    try:
        port = ports[parts.scheme] if parts.port is None else parts.port
    except ValueError:
        port = 0
    if not port:
        raise WrongValue.about(key, f"the port must be in 1..65535: {text!r}")
    return ServerUrl(parts.scheme, parts.hostname, port)


class SecretFile:
    """A secret in a file that only its owner can read, without ends of lines at its end."""

    def __init__(self, path: str | PathLike[str], kind: type[FileError] = FileError) -> None:
        self.path: str = os.fspath(path)
        self._kind = kind
        self._content = RenewedValue(self._read)

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
    """The certificate authorities that an output trusts: those in a file, or of the system."""

    def __init__(self, ca: str | None, sockets: type[ssl.SSLSocket] = ssl.SSLSocket) -> None:
        self._ca = ca
        self._sockets = sockets
        self._made: RenewedValue[ssl.SSLContext] | None = None

    async def context(self) -> ssl.SSLContext:
        """Return the context of TLS, or raise OSError; a file is read again each time."""
        if self._made is None:
            self._made = await asyncio.to_thread(RenewedValue, self._read)
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
