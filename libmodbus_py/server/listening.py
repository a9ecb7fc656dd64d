"""
The sockets of a server's endpoint.
"""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ..ports.endpoint import Endpoint
from ..ports.waiting import no_thread
from ..protocol.errors import ModbusConnectionError

__all__ = ["bound", "reason"]

# A family, host and port -> a socket bound to them.
Make = Callable[[socket.AddressFamily, tuple[str, int]], socket.socket]


async def bound(
    endpoint: Endpoint, kind: socket.SocketKind, make: Make
) -> tuple[list[socket.socket], Endpoint]:
    """
    Return a socket for each address of an endpoint's host, and the endpoint with its port.

    Raises:
        ModbusConnectionError: the host is unknown, or an address cannot be bound.
    """
    port = endpoint.port
    sockets: list[socket.socket] = []
    try:
        for family, host in await _addresses(endpoint, kind):
            sockets.append(make(family, (host, port)))
            sockets[-1].setblocking(False)
            if not port:  # a port that is free on one address may be taken on the next
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
    try:  # a numeric address needs no look-up, and so no thread
        found = socket.getaddrinfo(
            endpoint.host,
            endpoint.port,
            type=kind,
            flags=socket.AI_PASSIVE | socket.AI_NUMERICHOST,
        )
    except (OSError, UnicodeError):
        found = await _looked_up(endpoint, kind)
    return list(dict.fromkeys((family, str(address[0])) for family, *_, address in found))


async def _looked_up(endpoint: Endpoint, kind: socket.SocketKind) -> list[Any]:
    loop = asyncio.get_running_loop()
    try:
        return await loop.getaddrinfo(
            endpoint.host, endpoint.port, type=kind, flags=socket.AI_PASSIVE
        )
    except RuntimeError as error:  # the loop looks up in a thread, and there are too many threads
        raise no_thread(error) from error


def reason(error: OSError) -> str:
    """Return the system's text for an error; numbers of getaddrinfo are negative."""
    number = error.errno or 0
    return os.strerror(number) if number > 0 else str(error.strerror or error)
