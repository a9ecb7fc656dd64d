"""
Sockets to listen on: one for each address of a host.
"""

from __future__ import annotations

import errno
import os
import socket
from collections.abc import Callable
from typing import Any

__all__ = ["Make", "bind_all", "listen_on", "look_up", "reason", "tcp_listener"]

# A family, host and port -> a socket bound to them.
Make = Callable[[socket.AddressFamily, tuple[str, int]], socket.socket]

# Connections that may wait in the system.
BACKLOG = 4096

# An address of a family that this machine does not have, such as ::1 without IPv6.
NOT_HERE = (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT)


def look_up(host: str, port: int, kind: socket.SocketKind) -> list[Any]:
    """
    Return what getaddrinfo says of a host.

    Raises:
        OSError: the host is unknown.
        UnicodeError: no host can have this name.
    """
    return socket.getaddrinfo(host, port, type=kind, flags=socket.AI_PASSIVE)


def bind_all(found: list[Any], port: int, make: Make) -> list[socket.socket]:
    """
    Return a socket for each address that getaddrinfo found.

    An address that this machine does not have is left out if there are others. For port 0 there is
    one socket only, because a port that is free on one address may be taken on the next.

    Raises:
        OSError: an address cannot be bound; no socket is left open.
    """
    sockets: list[socket.socket] = []
    missing: OSError | None = None
    try:
        for family, host in dict.fromkeys((each[0], str(each[4][0])) for each in found):
            try:
                sockets.append(make(family, (host, port)))
            except OSError as error:
                if error.errno not in NOT_HERE:
                    raise
                missing = error
                continue
            if not port:
                break
        if missing is not None and not sockets:
            raise missing
    except OSError:
        for each in sockets:
            each.close()
        raise
    return sockets


def tcp_listener(family: socket.AddressFamily, address: tuple[str, int]) -> socket.socket:
    """Return a socket that listens on an address; errors have the system's text alone."""
    try:
        return socket.create_server(address, family=family, backlog=BACKLOG)
    except OSError as error:
        raise OSError(error.errno, reason(error)) from error


def listen_on(host: str, port: int) -> list[socket.socket]:
    """
    Return a TCP socket that listens on each address of a host.

    Raises:
        OSError: the host is unknown, or an address cannot be bound.
    """
    try:
        found = look_up(host, port, socket.SOCK_STREAM)
    except UnicodeError as error:
        raise OSError(errno.EINVAL, f"{host!r} cannot be the name of a host") from error
    return bind_all(found, port, tcp_listener)


def reason(error: OSError) -> str:
    """Return the system's text for an error; numbers of getaddrinfo are negative."""
    number = error.errno or 0
    return os.strerror(number) if number > 0 else str(error.strerror or error)
