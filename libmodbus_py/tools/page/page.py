"""
A live page of a server or of tables, while a block runs.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass

from ..faults.server import Server
from .server_source import ServerSource
from .streams import PageSource, Streams
from .table_source import TableSource
from .web import WebServer, checked_token

__all__ = ["Page", "live_page", "table_page"]


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
    if token is not None:
        checked_token(token)
    streams = Streams(source)
    web = WebServer(host, port, streams, token)
    with contextlib.ExitStack() as stack:
        stack.callback(web.server_close)
        stack.enter_context(tracing)
        stack.enter_context(streams.sending())
        stack.enter_context(web.serving("page web"))
        yield Page(web.url)
