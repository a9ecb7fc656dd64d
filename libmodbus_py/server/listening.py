"""
The sockets of a server's endpoint.
"""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Callable
from dataclasses import replace

from ..ports.endpoint import Endpoint
from ..protocol.errors import ModbusConnectionError

__all__ = ["bound", "reason"]

# A family, host and port -> a socket bound to them.
Make = Callable[[socket.AddressFamily, tuple[str, int]], socket.socket]


async def bound(
    endpoint: Endpoint, kind: socket.SocketKind, make: Make
) -> tuple[list[socket.socket], Endpoint]:
    """
    Make a socket for each address of an endpoint's host; give the endpoint with its port, too.

    Raises:
        ModbusConnectionError: the host is unknown, or an address cannot be had.
    """
    port = endpoint.port
    sockets: list[socket.socket] = []
    try:
        for family, host in await _addresses(endpoint, kind):
            sockets.append(make(family, (host, port)))
            sockets[-1].setblocking(False)
            if not port:  # a free one is free on one address; on the next it may be taken
                port = sockets[0].getsockname()[1]
                break
    except OSError as error:
        for each in sockets:
            each.close()
        raise ModbusConnectionError(
            f"cannot listen on {endpoint}: {reason(error)}", errno=error.errno
        ) from error
    return sockets, replace(endpoint, port=port)


async def _addresses(
    endpoint: Endpoint, kind: socket.SocketKind
) -> list[tuple[socket.AddressFamily, str]]:
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(endpoint.host, endpoint.port, type=kind, flags=socket.AI_PASSIVE)
    return list(dict.fromkeys((family, str(address[0])) for family, *_, address in found))


def reason(error: OSError) -> str:
    """The system's own words; getaddrinfo's numbers are negative."""
    number = error.errno or 0
    return os.strerror(number) if number > 0 else str(error.strerror or error)
