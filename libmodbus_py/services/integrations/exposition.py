"""
Metrics over HTTP: for the command line, and programs that have no web server of their own.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from ...tools.timed_server import TimedServer
from .prometheus import REGISTRY, CollectorRegistry, MetricsHandler

__all__ = ["exposing"]

# Seconds that a request and its answer may take.
LIMIT = 3.0


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
    server = TimedServer(host, port, MetricsHandler.factory(registry), LIMIT)
    with server.serving("metrics"):
        yield f"{server.place}/metrics"
