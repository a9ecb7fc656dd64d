"""
Metrics over HTTP: for the command line, and programs that have no web server of their own.
"""

from __future__ import annotations

import contextlib
import socket
import socketserver
import threading
from collections.abc import Iterator

from .prometheus import REGISTRY, CollectorRegistry, MetricsHandler

__all__ = ["exposing"]

# Somebody who connects and asks nothing keeps all others waiting.
PATIENCE = 2.0


class _Server(socketserver.TCPServer):
    """One request after the other: no thread for each of them, and no name looked up."""

    allow_reuse_address = True

    def __init__(self, host: str, port: int, handler: type) -> None:
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        super().__init__((host, port), handler)

    def handle_error(self, request: object, client_address: object) -> None:
        """Whoever asked has gone."""


@contextlib.contextmanager
def exposing(host: str, port: int, registry: CollectorRegistry = REGISTRY) -> Iterator[str]:
    """
    Answer GET with the metrics of a registry, while the ``with`` block runs.

    Args:
        host: an address to listen on.
        port: 0 for a free one.

    Returns:
        The URL, with the port it got.

    Raises:
        OSError: the address cannot be had.
    """
    handler = type("Handler", (MetricsHandler,), {"registry": registry, "timeout": PATIENCE})
    with _Server(host, port, handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.1,), name="metrics")
        thread.start()
        try:
            shown = f"[{host}]" if ":" in host else host
            yield f"http://{shown}:{server.server_address[1]}/metrics"
        finally:
            server.shutdown()
            thread.join()
