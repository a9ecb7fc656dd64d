"""
Readiness for systemd: one datagram, as sd_notify(3) describes.
"""

from __future__ import annotations

import contextlib
import os
import socket

__all__ = ["notify_ready"]


def notify_ready() -> None:
    """Notify the service manager that the command serves; do nothing without one."""
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
