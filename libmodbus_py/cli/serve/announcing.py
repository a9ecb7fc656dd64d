"""
Messages of a server: where it listens, and who can reach it.
"""

from __future__ import annotations

from collections.abc import Callable

from ...ports.endpoint import Endpoint, parse
from ...ports.hosts import is_loopback
from ...server.server import Running
from ..output import complain
from .readiness import notify_ready

__all__ = ["announcing"]


def announcing(allowed: list[str] | None) -> Callable[[Running], None]:
    """
    Return a function that prints where a server listens, and notifies systemd.

    Args:
        allowed: the networks that the server serves; None for all.
    """

    def announce(running: Running) -> None:
        for url in running.urls:
            print(f"listening on {url}", flush=True)
        unguarded = [] if allowed else [url for url in running.urls if _is_open(parse(url))]
        if unguarded:
            complain(
                f"anyone who can reach {', '.join(unguarded)} can read and write; --allow NETWORK,"
                " or tls:// with certificates, restricts access"
            )
        notify_ready()

    return announce


def _is_open(endpoint: Endpoint) -> bool:
    """Return True if other machines can reach an endpoint that asks for no certificate."""
    return not (endpoint.has_path or endpoint.is_secure or is_loopback(endpoint.host))
