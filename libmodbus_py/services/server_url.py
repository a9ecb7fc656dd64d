"""
URLs of the servers of other software: brokers, databases, NATS.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple
from urllib.parse import urlsplit

from ..ports.hosts import host_and_port
from ..protocol.mistakes import WrongType, WrongValue

__all__ = ["ServerUrl", "server_url", "url_without_login"]


class ServerUrl(NamedTuple):
    """
    The parts of the URL of a server.

    Attributes:
        scheme: in lower case.
        host: a name in lower case, or an address; an IPv6 address has no brackets.
        port: 1..65535; the default of the scheme if the URL has none; 0 if the port in the URL is
            invalid.
        has_login: True if the URL contains a user or a password.
    """

    scheme: str
    host: str
    port: int
    has_login: bool

    @property
    def place(self) -> str:
        """Host and port, equal for all spellings of the same host and port."""
        return host_and_port(self.host, self.port)


def server_url(
    text: str, ports: Mapping[str, int], *, may_have_path: bool = False
) -> ServerUrl | None:
    """
    Read the URL of a server; return None if the text is not one.

    Args:
        text: the URL.
        ports: allowed scheme -> its default port.
        may_have_path: True if a path may follow the port.
    """
    try:
        parts = urlsplit(text)
    except ValueError:  # such as brackets without an address
        return None
    is_plain = text.isascii() and text.isprintable() and " " not in text
    if parts.scheme not in ports or not parts.hostname or not is_plain:
        return None
    if parts.query or parts.fragment or (parts.path not in ("", "/") and not may_have_path):
        return None
    try:
        port = ports[parts.scheme] if parts.port is None else parts.port
    except ValueError:
        port = 0
    has_login = parts.username is not None or parts.password is not None
    return ServerUrl(parts.scheme, parts.hostname, port, has_login)


def url_without_login(
    given: object, ports: Mapping[str, int], example: str, *, may_have_path: bool = False
) -> ServerUrl:
    """
    Read the argument `url` of an output that has separate arguments for user and password.

    Args:
        given: the argument.
        ports, may_have_path: as for `server_url`.
        example: a valid URL, for error messages.

    Raises:
        TypeError, ValueError: the argument is not such an URL, or contains a user or a password.
    """
    if not isinstance(given, str):
        raise WrongType("url", f"must be text, not {type(given).__name__}")
    found = server_url(given, ports, may_have_path=may_have_path)
    if found is not None and found.has_login:
        raise WrongValue("url", "must not contain a user or password: write them as separate keys")
    if found is None:
        raise WrongValue("url", f'must be a URL such as "{example}", not {_without_login(given)!r}')
    if not found.port:
        raise WrongValue.about("url", f"the port must be in 1..65535: {_without_login(given)!r}")
    return found


def _without_login(text: str) -> str:
    """Return a text that is no valid URL without what may be a user and a password."""
    scheme, mark, rest = text.partition("://")
    if not mark:
        scheme, rest = "", text
    return f"{scheme}{mark}***@{rest.rpartition('@')[2]}" if "@" in rest else text
