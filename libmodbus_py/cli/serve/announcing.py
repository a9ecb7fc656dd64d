"""
Messages of a server: where it listens and who can reach it, and to systemd that it serves.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Callable
from typing import TYPE_CHECKING

from ...ports.endpoint import Endpoint, parse
from ...ports.hosts import is_loopback
from ..output import complain, inform

if TYPE_CHECKING:
    from ...server.server import Running

__all__ = ["announcing", "notify_ready"]


def announcing(allowed: list[str] | None) -> Callable[[Running], None]:
    """
    Return a function that prints where a server listens, and notifies systemd.

    Args:
        allowed: the networks that the server serves; None for all.
    """

    def announce(running: Running) -> None:
        for url in running.urls:
            inform(f"listening on {url}")
        unguarded = [] if allowed else [url for url in running.urls if _is_open(parse(url))]
        if unguarded:
            complain(
                f"anyone who can reach {', '.join(unguarded)} can read and write; --allow NETWORK,"
                " or tls:// with certificates, restricts access",
                "warning",
            )
        notify_ready()

    return announce


def _is_open(endpoint: Endpoint) -> bool:
    """Return True if other machines can reach an endpoint that asks for no certificate."""
    return not (endpoint.has_path or endpoint.is_secure or is_loopback(endpoint.host))


def notify_ready() -> None:
    """
    Notify the service manager that the command serves, with one datagram as sd_notify(3) describes;
    do nothing without one.
    """
    place = os.environ.get("NOTIFY_SOCKET", "")
    if not place.startswith(("/", "@")):
        return
    address = "\0" + place[1:] if place.startswith("@") else place
    # A manager that is gone is not a reason to stop serving.
    with (
        contextlib.suppress(OSError),
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender,
    ):
        sender.sendto(b"READY=1", address)
