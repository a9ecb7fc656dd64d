"""
The page over HTTP: a few paths; each request is checked, and limited in size and time.

Requests must have the token, and an address of the page in Host and Origin: its own, or the URL
under which a proxy shows it. A page of another program in the same browser has none of these. If
its name resolves to this address (DNS rebinding), the Host header contains that name; the Origin
header contains its address.
"""

from __future__ import annotations

import contextlib
import hmac
import json
import re
import secrets
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from email.message import Message
from http.server import BaseHTTPRequestHandler
from importlib import resources
from ipaddress import ip_address
from typing import Any
from urllib.parse import SplitResult, parse_qsl, urlsplit

from ...ports.hosts import is_loopback, split_host_and_port
from ...protocol.json_text import json_text
from ...server.server import Server
from ..timed_server import TimedServer
from .server_source import ServerSource
from .streams import Action, HttpRefusal, PageSource, Streams

# 22 characters have 128 bits, if they are chosen at random.
TOKEN = re.compile("[A-Za-z0-9_-]{22,200}")

DEFAULT_PORTS = {"http": 80, "https": 443}  # which browsers leave out of Host and Origin

PROXY = "if it is behind a proxy or a tunnel, give --page-url"


class _PageGuard:
    """Checks the requests to one page."""

    def __init__(
        self,
        host: str,
        addresses: Collection[str],
        port: int,
        token: str | None,
        outer: SplitResult | None,
    ) -> None:
        self.token: str = token or secrets.token_urlsafe(24)
        self._port = port
        self._cookie = f"libmodbus_page_{port}"
        self.set_cookie: str = f"{self._cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"
        self._is_any = any(ip_address(text.partition("%")[0]).is_unspecified for text in addresses)
        is_here = self._is_any or any(map(is_loopback, addresses))
        names = (host, *addresses, *(["localhost"] if is_here else []))
        self._names = {name.lower() for name in names}
        # Through a proxy: the Origin header, and the Host header if the proxy passes it on.
        self._outer_host = None if outer is None else outer.netloc.lower()
        self._outer_origin = None if outer is None else f"{outer.scheme}://{self._outer_host}"

    def check(self, token: str, headers: Message, *, is_change: bool) -> None:
        """Raise `HttpRefusal` if a request is not allowed."""
        host, origin = headers.get("Host", ""), headers.get("Origin")
        if len(headers.get_all("Host", [])) != 1 or not self._is_own(host):
            raise HttpRefusal(403, f"the Host header is not the address of this page; {PROXY}")
        origins = None, f"http://{host}", self._outer_origin
        if (is_change and origin is None) or origin not in origins:
            raise HttpRefusal(403, f"the Origin header is not the address of this page; {PROXY}")
        tokens = [token, *self._cookies(headers)]
        if not any(hmac.compare_digest(text.encode(), self.token.encode()) for text in tokens):
            raise HttpRefusal(403, "the token is missing or wrong: open the URL that was printed")

    def _is_own(self, host: str) -> bool:
        if host.lower() == self._outer_host:
            return True
        try:
            name, port = split_host_and_port(host.lower())
            if (80 if port is None else port) != self._port:
                return False
            # All addresses of this machine are allowed, and names of other pages are no addresses.
            return name in self._names or (
                self._is_any and bool(ip_address(name.partition("%")[0]))
            )
        except ValueError:
            return False

    def _cookies(self, headers: Message) -> Iterator[str]:
        """Yield the values of the page's cookie; `http.cookies` stops at one with JSON."""
        for header in headers.get_all("Cookie", []):
            for cookie in header.split(";"):
                name, _, value = cookie.strip().partition("=")
                if name == self._cookie:
                    yield value


# Seconds that a request and its answer may take.
LIMIT = 10.0

MOST_BODY = 65_536
MOST_FIELDS = 8

FOLDER = resources.files(__package__ or "")

FILES = {
    "/": ("page.html", "text/html; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
    "/icon.svg": ("icon.svg", "image/svg+xml"),
} | {
    f"/scripts/{script.name}": (f"scripts/{script.name}", "text/javascript; charset=utf-8")
    for script in FOLDER.joinpath("scripts").iterdir()
    if script.name.endswith(".js")
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
    """The page on one address; `url` has the token that a browser must send."""

    def __init__(
        self, host: str, port: int, source: PageSource, token: str | None, outer: SplitResult | None
    ) -> None:
        super().__init__(host, port, Handler, LIMIT)
        self.streams = Streams(source)
        self.actions: dict[str, Action] = {"/view": self.streams.look_at, **source.actions}
        self.downloads = source.downloads
        self.guard = _PageGuard(host, self.addresses, self.port, token, outer)
        place = self.place if outer is None else outer.geturl().rstrip("/")
        self.url: str = f"{place}/?token={self.guard.token}"


class Handler(BaseHTTPRequestHandler):
    """The single request of a connection."""

    server: _WebServer
    server_version = "libmodbus-py"
    sys_version = ""
    timeout = LIMIT

    def do_GET(self) -> None:
        self._answer(self._get)

    def do_POST(self) -> None:
        self._answer(self._post)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing, because HTTP requests are of no interest."""

    def end_headers(self) -> None:
        for name, value in HEADERS.items():
            self.send_header(name, value)
        super().end_headers()

    def _answer(self, answer: Callable[[str, dict[str, str]], None]) -> None:
        try:
            try:
                parts = urlsplit(self.path)
                fields = dict(parse_qsl(parts.query, max_num_fields=MOST_FIELDS))
            except ValueError:
                raise HttpRefusal(400, "the path is invalid, or has too many fields") from None
            token, is_change = fields.get("token", ""), self.command != "GET"
            self.server.guard.check(token, self.headers, is_change=is_change)
            answer(parts.path, fields)
        except HttpRefusal as refusal:
            self._send_json({"error": str(refusal)}, refusal.status)

    def _get(self, path: str, fields: dict[str, str]) -> None:
        download = self.server.downloads.get(path)
        if path == "/events":
            self._stream()
        elif download is not None:
            self._send("text/csv; charset=utf-8", download(fields).encode(errors="replace"))
        elif path in FILES:
            name, kind = FILES[path]
            self._send(kind, FOLDER.joinpath(name).read_bytes(), with_cookie=path == "/")
        else:
            raise HttpRefusal(404, "not found")

    def _post(self, path: str, _: dict[str, str]) -> None:
        action = self.server.actions.get(path)
        if action is None:
            raise HttpRefusal(404, "not found")
        try:
            result = action(self._body())
        except KeyError as error:
            raise HttpRefusal(400, f"{error} is missing") from None
        except (TypeError, ValueError) as error:
            raise HttpRefusal(400, str(error)) from None
        self._send_json(result or {})

    def _body(self) -> dict[str, Any]:
        if self.headers.get_content_type() != "application/json":
            raise HttpRefusal(415, "the Content-Type must be application/json")
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit()) or "Transfer-Encoding" in self.headers:
            raise HttpRefusal(411, "Content-Length is missing")
        if len(length) > 9 or int(length) > MOST_BODY:
            raise HttpRefusal(413, f"the body has more than {MOST_BODY} bytes")
        try:
            body = json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError):
            raise HttpRefusal(400, "the body is not valid JSON") from None
        if not isinstance(body, dict):
            raise HttpRefusal(400, "the body is not a JSON object")
        return body

    def _send(
        self, kind: str, data: bytes, status: int = 200, *, with_cookie: bool = False
    ) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(data)))
        if with_cookie:
            self.send_header("Set-Cookie", self.server.guard.set_cookie)
        self.end_headers()
        self.wfile.write(data)

    def _send_json(self, result: object, status: int = 200) -> None:
        self._send("application/json", json_text(result).encode(), status)

    def _stream(self) -> None:
        with self.server.streams.open_stream(self.connection) as messages:
            self.server.keep(self.connection)
            self.send_response(200)
            self.send_header("Content-Type", "text/event-stream; charset=utf-8")
            self.end_headers()
            for message in messages:
                self.wfile.write(message.encode())


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
    server: Server,
    host: str = "127.0.0.1",
    port: int = 0,
    token: str | None = None,
    url: str | None = None,
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
        url: the URL under which browsers reach the page, if it is not http://HOST:PORT because a
            proxy or a tunnel is in between, such as "https://plant.example/modbus".

    Returns:
        A context manager; ``with`` returns the `Page`.

    Raises:
        TypeError, ValueError: the token or the URL is wrong.
        OSError: the address cannot be used, or the system has no thread left.
    """
    source = ServerSource(server)
    with server.tracing(source.log.note), table_page(source, host, port, token, url) as page:
        yield page


@contextlib.contextmanager
def table_page(
    source: PageSource,
    host: str = "127.0.0.1",
    port: int = 0,
    token: str | None = None,
    url: str | None = None,
) -> Iterator[Page]:
    """Show a source, such as tables on which nothing can be changed; otherwise as `live_page`."""
    if not isinstance(token, str | None):
        raise TypeError(f"token must be a string, not {type(token).__name__}")
    if token is not None and not TOKEN.fullmatch(token):
        raise ValueError("token must have 22 or more letters, digits, - or _")
    web = _WebServer(host, port, source, token, None if url is None else _outer_url(url))
    with web.serving("page web"):
        yield Page(web.url)


def _outer_url(text: str) -> SplitResult:
    """Return the checked URL under which a proxy shows a page, as browsers write it."""
    if not isinstance(text, str):
        raise TypeError(f"url must be a string, not {type(text).__name__}")
    form = f"the page's URL must be as https://HOST or https://HOST/PATH, not {text!r}"
    try:
        url = urlsplit(text)
        default = DEFAULT_PORTS[url.scheme]
        host, _ = split_host_and_port(url.netloc)
    except (KeyError, ValueError):
        raise ValueError(form) from None
    if not host or "@" in host or url.query or url.fragment:
        raise ValueError(form)
    return url._replace(netloc=url.netloc.lower().removesuffix(f":{default}"))
