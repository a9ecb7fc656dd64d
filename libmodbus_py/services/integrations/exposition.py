"""
Serves metrics over HTTP, for the command line and for programs without a web server.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from ...tools.timed_server import TimedServer
from .prometheus import REGISTRY, CollectorRegistry, MetricsHandler

__all__ = ["exposing"]

# Seconds that an HTTP request and its response may take.
LIMIT = 3.0


@contextlib.contextmanager
def exposing(host: str, port: int, registry: CollectorRegistry = REGISTRY) -> Iterator[str]:
    """
    Serve the metrics of a registry over HTTP while the ``with`` block runs.

    Args:
        host: the address to listen on.
        port: the port to listen on; 0 for any free port.
        registry: the registry whose metrics are served.

    Returns:
        A context manager, whose value is the URL of the metrics with the port.

    Raises:
        OSError: the address or the port cannot be used.
    """
    server = TimedServer(host, port, MetricsHandler.factory(registry), LIMIT)
    with server.serving("metrics"):
        yield f"{server.place}/metrics"
