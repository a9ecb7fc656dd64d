"""
Checks requests: they must have the token, and the page's own address in Host and Origin.

A page of another program in the same browser has none of these. If its name resolves to this
address (DNS rebinding), the Host header contains that name; the Origin header contains its address.
"""

from __future__ import annotations

import hmac
import re
import secrets
from collections.abc import Collection, Iterator
from email.message import Message
from ipaddress import ip_address
from urllib.parse import parse_qs

from ...ports.hosts import is_loopback, split_host_and_port

__all__ = ["PageGuard", "checked_token"]

# 22 characters have 128 bits, if they are chosen at random.
TOKEN = re.compile("[A-Za-z0-9_-]{22,200}")


class PageGuard:
    """
    Checks the requests to one page.

    Args:
        host: the name or address on which the page listens, as it was given.
        addresses: the addresses of this host.
        port: the port on which it listens.
        token: the token that requests must have (`checked_token`); None for a new one.
    """

    def __init__(
        self, host: str, addresses: Collection[str], port: int, token: str | None = None
    ) -> None:
        self.token: str = token or secrets.token_urlsafe(24)
        self._port = port
        self._is_any = any(ip_address(each.partition("%")[0]).is_unspecified for each in addresses)
        is_here = self._is_any or any(map(is_loopback, addresses))
        names = (host, *addresses, *(["localhost"] if is_here else []))
        self._names = {each.lower() for each in names}
        self._cookie = f"libmodbus_page_{self._port}"

    @property
    def cookie(self) -> str:
        """The value of the Set-Cookie header, with which a browser sends the token from then on."""
        return f"{self._cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"

    def refusal(self, query: str, headers: Message, *, is_change: bool) -> str:
        """Return the reason to refuse a request; an empty string if it is allowed."""
        host = headers.get("Host", "")
        if len(headers.get_all("Host", [])) != 1 or not self._is_own(host):
            return "the Host header is not the address of this page"
        origin = headers.get("Origin")
        if (is_change and origin is None) or origin not in (None, f"http://{host}"):
            return "the Origin header is not the address of this page"
        if not self._has_token(query, headers):
            return "the token is missing or wrong: open the URL that was printed"
        return ""

    def _is_own(self, host: str) -> bool:
        try:
            name, port = split_host_and_port(host.lower())
        except ValueError:
            return False
        if (80 if port is None else port) != self._port:
            return False
        return name in self._names or (self._is_any and _is_address(name))

    def _has_token(self, query: str, headers: Message) -> bool:
        given = [*_tokens(query), *self._kept(headers)]
        return any(hmac.compare_digest(each.encode(), self.token.encode()) for each in given)

    def _kept(self, headers: Message) -> Iterator[str]:
        """
        Yield the values of the page's cookie, and ignore all other cookies.

        Pages on all ports of a machine share their cookies, and `http.cookies` stops at the first
        that it cannot parse, such as one that contains JSON.
        """
        for header in headers.get_all("Cookie", []):
            for each in header.split(";"):
                name, _, value = each.strip().partition("=")
                if name == self._cookie:
                    yield value


def checked_token(token: str) -> str:
    """
    Return a token.

    Raises:
        TypeError, ValueError: it is too short, or contains other characters than letters,
            digits, - and _.
    """
    if not isinstance(token, str):
        raise TypeError(f"token must be a string, not {type(token).__name__}")
    if not TOKEN.fullmatch(token):
        raise ValueError("token must have 22 or more letters, digits, - or _")
    return token


def _tokens(query: str) -> list[str]:
    try:
        return parse_qs(query, max_num_fields=8).get("token", [])
    except ValueError:  # there are more fields
        return []


def _is_address(name: str) -> bool:
    try:
        ip_address(name.partition("%")[0])
    except ValueError:
        return False
    return True
