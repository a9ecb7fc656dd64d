"""
URLs of the servers of other software: brokers, databases, NATS.

None contains a user, a password or a token: URLs are logged and shown in lists of processes. Each
server has settings for these, of which one names a file.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple
from urllib.parse import urlsplit

from ..ports.hosts import host_and_port
from ..protocol.mistakes import WrongType, WrongValue

__all__ = ["ServerUrl", "server_url"]


class ServerUrl(NamedTuple):
    """
    The parts of the URL of a server.

    Attributes:
        scheme: in lower case.
        host: a name in lower case, or an address; an IPv6 address has no brackets.
        port: 1..65535; the default of the scheme if the URL has none.
    """

    scheme: str
    host: str
    port: int

    @property
    def place(self) -> str:
        """Host and port, equal for all spellings of the same host and port."""
        return host_and_port(self.host, self.port)


def server_url(
    key: str,
    given: object,
    ports: Mapping[str, int],
    *,
    example: str,
    login: str,
    may_have_path: bool = False,
) -> ServerUrl:
    """
    Read the URL of a server.

    Args:
        key: the name of the setting, for errors.
        given: the URL.
        ports: allowed scheme -> its default port.
        example: a valid URL, for errors.
        login: the settings for user, password and token, for errors.
        may_have_path: True if a path may follow the port.

    Raises:
        TypeError, ValueError: the setting is not such a URL, or contains a login, which the error
            does not repeat.
    """
    if not isinstance(given, str):
        raise WrongType(key, f"must be text, not {type(given).__name__}")
    if "@" in given:
        raise WrongValue(key, f"must not contain a user or password: use {login}")
    shown = given.partition("?")[0]  # a query may contain a token
    wrong = WrongValue(key, f'must be a URL such as "{example}", not {shown!r}')
    try:
        parts = urlsplit(given)
    except ValueError:  # such as brackets without an address
        raise wrong from None
    is_plain = given.isascii() and given.isprintable() and " " not in given
    if parts.scheme not in ports or not parts.hostname or not is_plain:
        raise wrong
    if parts.query or parts.fragment or (parts.path not in ("", "/") and not may_have_path):
        raise wrong
    try:
        port = ports[parts.scheme] if parts.port is None else parts.port
    except ValueError:
        port = 0
    if not port:
        raise WrongValue.about(key, f"the port must be in 1..65535: {shown!r}")
    return ServerUrl(parts.scheme, parts.hostname, port)
