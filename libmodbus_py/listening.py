"""
Where a server listens.
"""

from __future__ import annotations

import asyncio
import os
import socket

from .errors import ModbusConnectionError
from .url import Endpoint

__all__ = ["addresses", "reason"]


async def addresses(
    endpoint: Endpoint, kind: socket.SocketKind
) -> list[tuple[socket.AddressFamily, str]]:
    """
    Find the addresses of an endpoint's host.

    Raises:
        ModbusConnectionError: it has none.
    """
    loop = asyncio.get_running_loop()
    try:
        found = await loop.getaddrinfo(
            endpoint.host, endpoint.port, type=kind, flags=socket.AI_PASSIVE
        )
    except OSError as error:
        raise ModbusConnectionError(
            f"cannot listen on {endpoint}: {reason(error)}", errno=error.errno
        ) from error
    return list(dict.fromkeys((family, str(address[0])) for family, *_, address in found))


def reason(error: OSError) -> str:
    """The system's own words; getaddrinfo's numbers are negative."""
    number = error.errno or 0
    return os.strerror(number) if number > 0 else str(error.strerror or error)
