"""
The page over HTTP: a few paths; each request is checked, and limited in size and time.

Requests must have the token, and the page's own address in Host and Origin. A page of another
program in the same browser has none of these. If its name resolves to this address (DNS rebinding),
the Host header contains that name; the Origin header contains its address.
"""

from __future__ import annotations

import contextlib
import hmac
import http.client
import json
import re
import secrets
import select
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from email.message import Message
from http.server import BaseHTTPRequestHandler
from importlib import resources
from ipaddress import ip_address
from typing import Any
from urllib.parse import parse_qs, parse_qsl, urlsplit

from ...ports.hosts import is_loopback, split_host_and_port
from ...protocol.json_text import json_text
from ..faults.server import Server
from ..timed_server import TimedServer
from .server_source import ServerSource
from .streams import Action, FullError, PageSource, PageStream, Streams
from .table_source import TableSource

__all__ = ["Page", "live_page", "table_page"]

# 22 characters have 128 bits, if they are chosen at random.
TOKEN = re.compile("[A-Za-z0-9_-]{22,200}")


class _PageGuard:
    """Checks the requests to one page."""

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


# --- the checks of requests -----------------------------------------------------------------------


# Seconds that a request and its answer may take.
LIMIT = 10.0

# Seconds after which an idle stream sends a comment, which shows whether the browser is there.
HEARTBEAT = 5.0

MOST_HEAD = 16_384
MOST_BODY = 65_536
MOST_FIELDS = 8

FOLDER = resources.files(__package__ or "")

FILES = {
    "/": ("page.html", "text/html; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
    "/icon.svg": ("icon.svg", "image/svg+xml"),
} | {
    f"/scripts/{each.name}": (f"scripts/{each.name}", "text/javascript; charset=utf-8")
    for each in FOLDER.joinpath("scripts").iterdir()
    if each.name.endswith(".js")
}
"""Path -> file in this folder, and its media type."""

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self';"
    " img-src 'self'; connect-src 'self'; base-uri 'none'; form-action 'none';"
    " frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class _WebServer(TimedServer):
    """
    The page on one address.

    Args:
        token: the token that requests must have; None for a new one.

    Attributes:
        url: with the token that a browser must send.

    Raises:
        OSError: the address cannot be used.
    """

    def __init__(self, host: str, port: int, streams: Streams, token: str | None = None) -> None:
        super().__init__(host, port, Handler, LIMIT)
        self.streams = streams
        self.actions: dict[str, Action] = {"/view": streams.look_at, **streams.source.actions}
        self.guard: _PageGuard = _PageGuard(host, self.addresses, self.port, token)
        self.url: str = f"{self.place}/?token={self.guard.token}"


class Head:
    """The head of a request, of at most `MOST_HEAD` bytes."""

    def __init__(self, file: Any) -> None:
        self._file = file
        self._left = MOST_HEAD

    def readline(self, size: int = -1) -> bytes:
        most = self._left + 1
        line: bytes = self._file.readline(min(size, most) if size >= 0 else most)
        self._left -= len(line)
        if self._left < 0:
            raise http.client.LineTooLong("head")
        return line

    def read(self, size: int) -> bytes:
        data: bytes = self._file.read(size)
        return data

    def close(self) -> None:
        self._file.close()


class Refused(Exception):
    """A request that is answered with this status and text."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


class Handler(BaseHTTPRequestHandler):
    """The single request of a connection."""

    server: _WebServer
    server_version = "libmodbus-py"
    sys_version = ""
    timeout = LIMIT

    def setup(self) -> None:
        super().setup()
        self.rfile = Head(self.rfile)  # type: ignore[assignment]

    def do_GET(self) -> None:
        self._answer(self._get)

    def do_POST(self) -> None:
        self._answer(self._post)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing."""

    def end_headers(self) -> None:
        for name, value in HEADERS.items():
            self.send_header(name, value)
        super().end_headers()

    def _answer(self, answer: Callable[[str, str], None]) -> None:
        try:
            path, query = self._split()
            why = self.server.guard.refusal(query, self.headers, is_change=self.command != "GET")
            if why:
                raise Refused(403, why)
            answer(path, query)
        except Refused as refusal:
            self._send(refusal.status, "application/json", _json({"error": str(refusal)}))

    def _split(self) -> tuple[str, str]:
        try:
            parts = urlsplit(self.path)
        except ValueError:
            raise Refused(400, "the path is invalid") from None
        return parts.path, parts.query

    def _get(self, path: str, query: str) -> None:
        if path == "/events":
            self._stream()
            return
        download = self.server.streams.source.downloads.get(path)
        if download is not None:
            text = download(_fields(query))
            self._send(200, "text/csv; charset=utf-8", text.encode(errors="replace"))
            return
        if path not in FILES:
            raise Refused(404, "not found")
        name, kind = FILES[path]
        self._send(200, kind, FOLDER.joinpath(name).read_bytes(), with_cookie=path == "/")

    def _post(self, path: str, query: str) -> None:
        action = self.server.actions.get(path)
        if action is None:
            raise Refused(404, "not found")
        try:
            found = action(self._body())
        except (TypeError, ValueError, KeyError) as error:
            text = str(error) if not isinstance(error, KeyError) else f"{error} is missing"
            raise Refused(400, text) from None
        self._send(200, "application/json", _json(found or {}))

    def _body(self) -> dict[str, Any]:
        if self.headers.get_content_type() != "application/json":
            raise Refused(415, "the Content-Type must be application/json")
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit()) or "Transfer-Encoding" in self.headers:
            raise Refused(411, "Content-Length is missing")
        if len(length) > 9 or int(length) > MOST_BODY:
            raise Refused(413, f"the body has more than {MOST_BODY} bytes")
        data = self.rfile.read(int(length))
        try:
            found = json.loads(data)
        except (ValueError, RecursionError):
            raise Refused(400, "the body is not valid JSON") from None
        if not isinstance(found, dict):
            raise Refused(400, "the body is not a JSON object")
        return found

    def _send(self, status: int, kind: str, data: bytes, *, with_cookie: bool = False) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(data)))
        if with_cookie:
            self.send_header("Set-Cookie", self.server.guard.cookie)
        self.end_headers()
        self.wfile.write(data)

    # --- the stream ----------------------------------------------------------------------------

    def _stream(self) -> None:
        try:
            with self.server.streams.opened() as stream:
                self.server.keep(self.connection)
                self.send_response(200)
                self.send_header("Content-Type", "text/event-stream; charset=utf-8")
                self.end_headers()
                self._feed(stream)
        except FullError as error:
            raise Refused(503, str(error)) from None

    def _feed(self, stream: PageStream) -> None:
        """Send messages until the browser closes the connection or stops reading."""
        poll = select.poll()
        poll.register(self.connection, select.POLLIN | select.POLLHUP)
        poll.register(stream.wake, select.POLLIN)
        while True:
            ready = dict(poll.poll(HEARTBEAT * 1000))
            if self.connection.fileno() in ready:  # the browser has closed the connection
                return
            message = stream.take() if ready else ": \n\n"
            self.wfile.write(message.encode())


def _fields(query: str) -> dict[str, str]:
    try:
        return dict(parse_qsl(query, max_num_fields=MOST_FIELDS))
    except ValueError:
        raise Refused(400, "the query has too many fields") from None


def _json(found: object) -> bytes:
    return json_text(found).encode()


# --- pages while a block runs ---------------------------------------------------------------------


@dataclass(frozen=True)
class Page:
    """
    A live page.

    Attributes:
        url: the URL of the page, with the token that is needed to open it.
    """

    url: str


@contextlib.contextmanager
def live_page(
    server: Server, host: str = "127.0.0.1", port: int = 0, token: str | None = None
) -> Iterator[Page]:
    """
    Show a server on a live page, over HTTP, while the ``with`` block runs.

    The page has a few threads of its own, which are idle while no browser shows it. Values are set
    on it as by this program: hooks for writes are not called. To show values, a thread of the page
    calls `before_read` of devices. The log of the page does not contain connections that clients
    made before the page was opened.

    Args:
        server: the server, which may run or not.
        host: an address of this machine to listen on. Anyone who can reach it and has the URL can
            change everything, and the traffic is not encrypted.
        port: 0..65535; 0 for a free port.
        token: the token in the URL of the page: 22 or more letters, digits, - or _, chosen at
            random; None for a new one each time.

    Returns:
        A context manager; ``with`` returns the `Page`.

    Raises:
        TypeError, ValueError: the token is wrong.
        OSError: the address cannot be used, or the system has no thread left.
    """
    source = ServerSource(server)
    with _page_of(source, host, port, token, server.tracing(source.log.note)) as page:
        yield page


@contextlib.contextmanager
def table_page(
    source: TableSource, host: str = "127.0.0.1", port: int = 0, token: str | None = None
) -> Iterator[Page]:
    """
    Show tables on a live page while the ``with`` block runs; nothing can be changed on it.

    Args:
        source: the tables.
        host, port, token: as for `live_page`.

    Raises:
        TypeError, ValueError, OSError: as for `live_page`.
    """
    with _page_of(source, host, port, token, contextlib.nullcontext()) as page:
        yield page


@contextlib.contextmanager
def _page_of(
    source: PageSource,
    host: str,
    port: int,
    token: str | None,
    tracing: contextlib.AbstractContextManager[None],
) -> Iterator[Page]:
    if not isinstance(token, str | None):
        raise TypeError(f"token must be a string, not {type(token).__name__}")
    if token is not None and not TOKEN.fullmatch(token):
        raise ValueError("token must have 22 or more letters, digits, - or _")
    streams = Streams(source)
    web = _WebServer(host, port, streams, token)
    with contextlib.ExitStack() as stack:
        stack.callback(web.server_close)
        stack.enter_context(tracing)
        stack.enter_context(streams.sending())
        stack.enter_context(web.serving("page web"))
        yield Page(web.url)
