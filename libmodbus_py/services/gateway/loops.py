"""
Lines that lead back to where a gateway listens itself, or to no port at all.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Iterable

from ...ports.endpoint import Endpoint
from ...protocol.mistakes import Path, WrongValue

__all__ = ["check_line"]

LOCALHOST = ("localhost", "ip6-localhost")
EVERYWHERE = ("0.0.0.0", "::")


def check_line(name: Path, line: Endpoint, listening: Iterable[Endpoint]) -> None:
    """
    Check that a line leads somewhere else.

    Args:
        name: of it, for the error.
        listening: where the gateway listens.

    Raises:
        ValueError: there is no such port, or the gateway itself listens there.
    """
    if line.transport == "serial" and not os.path.exists(line.device):
        raise WrongValue.about(name, f"there is no port {line.device}")
    for own in listening:
        if _is_same(line, own):
            raise WrongValue.about(name, f"the gateway itself listens on {own}")


def _is_same(line: Endpoint, own: Endpoint) -> bool:
    if line.transport == "serial" or own.transport == "serial":
        both = line.transport == own.transport
        return both and os.path.realpath(line.device) == os.path.realpath(own.device)
    if (line.transport == "udp") != (own.transport == "udp") or line.port != own.port:
        return False
    if own.host in EVERYWHERE:
        return _is_here(line.host)
    return line.host == own.host or (_is_loopback(line.host) and _is_loopback(own.host))


def _is_loopback(host: str) -> bool:
    return host in LOCALHOST or host.startswith("127.") or host == "::1" or host in EVERYWHERE


def _is_here(host: str) -> bool:
    """Whether an address is one of this machine; names but localhost are not looked up."""
    if _is_loopback(host):
        return True
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.inet_pton(family, host)
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.bind((host, 0))
    except OSError:
        return False
    return True
