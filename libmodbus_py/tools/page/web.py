"""
The page over HTTP: a few paths; each request is checked, and limited in size and time.
"""

from __future__ import annotations

import http.client
import json
import select
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler
from importlib import resources
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from ...protocol.plain import json_text
from ..timed_server import TimedServer
from .guard import PageGuard
from .streams import Action, FullError, PageStream, Streams

__all__ = ["WebServer"]

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


class WebServer(TimedServer):
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
        self.guard: PageGuard = PageGuard(host, self.addresses, self.port, token)
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

    server: WebServer
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
