"""
The sockets of a server's endpoint.
"""

from __future__ import annotations

import math
import socket
from dataclasses import replace
from typing import Any

from ..ports.endpoint import Endpoint
from ..ports.listening import Make, bind_all, reason
from ..ports.names import Resolve, numeric
from ..ports.waiting_async import look_up
from ..protocol.errors import ModbusConnectionError

__all__ = ["bound"]


async def bound(
    endpoint: Endpoint, kind: socket.SocketKind, make: Make
) -> tuple[list[socket.socket], Endpoint]:
    """
    Return a socket for each address of an endpoint's host, and the endpoint with its port.

    Raises:
        ModbusConnectionError: the host is unknown, or an address cannot be bound.
    """
    try:
        sockets = bind_all(await _addresses(endpoint, kind), endpoint.port, make)
    except OSError as error:
        raise ModbusConnectionError(
            f"cannot listen on {endpoint}: {reason(error)}", errno=error.errno
        ) from error
    for each in sockets:
        each.setblocking(False)
    return sockets, replace(endpoint, port=sockets[0].getsockname()[1])


async def _addresses(endpoint: Endpoint, kind: socket.SocketKind) -> list[Any]:
    wanted = Resolve(endpoint.host, endpoint.port, kind, math.inf, socket.AI_PASSIVE)
    return numeric(wanted) or await look_up(wanted)
