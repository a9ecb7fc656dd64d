"""
A page of a server, while a block runs.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass

from ...server.server import Server
from .streams import Streams
from .web import WebServer

__all__ = ["Page", "live_page"]


@dataclass(frozen=True)
class Page:
    """
    A live page.

    Attributes:
        url: where it is, with the token that whoever opens it must have.
    """

    url: str


@contextlib.contextmanager
def live_page(server: Server, host: str = "127.0.0.1", port: int = 0) -> Iterator[Page]:
    """
    Show a server on a live page, over HTTP, while the ``with`` block runs.

    It has a few threads of its own, and does nothing while nobody watches. Values set there are
    set as by this program: hooks about writes are not called. `before_read` of devices is called
    from its thread, for what is looked at. Connections that clients made before it began are not
    in its log.

    Args:
        host: an address of this machine to listen on. Whoever reaches it and has the URL may
            change everything, and nothing of it is encrypted.
        port: 0 for a free one.

    Raises:
        OSError: the address cannot be had, or no thread.
    """
    streams = Streams(server)
    web = WebServer(host, port, streams)
    with contextlib.ExitStack() as stack:
        stack.callback(web.server_close)
        stack.enter_context(server.tracing(streams.log.note))
        stack.enter_context(streams.sending())
        stack.enter_context(web.serving("page web"))
        yield Page(web.url)
