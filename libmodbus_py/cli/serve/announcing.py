"""
Where a server listens, and who may come, in words.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from ipaddress import ip_address

from ...ports.endpoint import Endpoint, parse
from ...server.server import Running

__all__ = ["announcing"]


def announcing(allowed: list[str] | None) -> Callable[[Running], None]:
    """
    Give what tells the user of a server that listens.

    Args:
        allowed: the networks that it serves; None for all.
    """

    def announce(running: Running) -> None:
        for url in running.urls:
            print(f"listening on {url}", flush=True)
        unguarded = [] if allowed else [url for url in running.urls if _is_open(parse(url))]
        if unguarded:
            print(
                f"libmodbus-py: anybody who reaches {', '.join(unguarded)} may read and write;"
                " --allow NETWORK, or certificates and tls://, say who may",
                file=sys.stderr,
                flush=True,
            )

    return announce


def _is_open(endpoint: Endpoint) -> bool:
    """Whether other machines may reach it, and nothing asks who they are."""
    if endpoint.transport in ("serial", "tls"):
        return False
    try:
        return not ip_address(endpoint.host.partition("%")[0]).is_loopback
    except ValueError:
        return endpoint.host != "localhost"
