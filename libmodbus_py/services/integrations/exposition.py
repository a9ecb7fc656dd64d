"""
Metrics over HTTP: for the command line, and programs that have no web server of their own.
"""

from __future__ import annotations

import contextlib
import socket
import socketserver
import threading
from collections.abc import Iterator
from typing import Any

from .prometheus import REGISTRY, CollectorRegistry, MetricsHandler

__all__ = ["exposing"]

# Somebody who asks slowly, or nothing, keeps all others waiting, and the end.
PATIENCE = 3.0


class _Server(socketserver.TCPServer):
    """One request after the other: no thread for each of them, and no name looked up."""

    allow_reuse_address = True

    def __init__(self, host: str, port: int, handler: type) -> None:
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        super().__init__((host, port), handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        alarm = threading.Timer(PATIENCE, _cut, (request,))
        alarm.daemon = True
        alarm.start()
        try:
            super().process_request(request, client_address)
        finally:
            alarm.cancel()

    def handle_error(self, request: object, client_address: object) -> None:
        """Whoever asked has gone."""


def _cut(request: socket.socket) -> None:
    with contextlib.suppress(OSError):  # it is over already
        request.shutdown(socket.SHUT_RDWR)


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
    with _Server(host, port, MetricsHandler.factory(registry)) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.1,), name="metrics")
        thread.start()
        try:
            shown = f"[{host}]" if ":" in host else host
            yield f"http://{shown}:{server.server_address[1]}/metrics"
        finally:
            server.shutdown()
            thread.join()
