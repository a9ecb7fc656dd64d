"""
The sockets of a server's endpoints.

A datagram is answered from the address that was asked: the clients of a machine with several
addresses, of this package and of others, take datagrams only from the address to which they sent.
"""

from __future__ import annotations

import math
import socket
import struct
from dataclasses import replace
from functools import lru_cache
from ipaddress import IPv6Address, ip_address
from typing import Any

from ..ports.endpoint import Endpoint
from ..ports.hosts import Make, Resolve, bind_all, reason
from ..ports.waiting_async import look_up
from ..protocol.errors import ModbusConnectionError
from ..system import IP_PKTINFO

__all__ = ["bound", "bound_datagrams"]


async def bound(
    endpoint: Endpoint, kind: socket.SocketKind, make: Make
) -> tuple[list[socket.socket], Endpoint]:
    """
    Return a socket for each address of an endpoint's host, and the endpoint with its port.

    Raises:
        ModbusConnectionError: the host is unknown, or an address cannot be bound.
    """
    try:
        wanted = Resolve(endpoint.host, endpoint.port, kind, math.inf, socket.AI_PASSIVE)
        sockets = bind_all(await look_up(wanted), endpoint.port, make)
    except OSError as error:
        raise ModbusConnectionError(
            f"cannot listen on {endpoint}: {reason(error)}", errno=error.errno
        ) from error
    for each in sockets:
        each.setblocking(False)
    return sockets, replace(endpoint, port=sockets[0].getsockname()[1])


# struct in_pktinfo: interface, the own address, the target; struct in6_pktinfo: target, interface.
IN_PKTINFO = struct.Struct("=i4s4s")
IN6_PKTINFO = struct.Struct("=16si")

ROOM = socket.CMSG_SPACE(max(IN_PKTINFO.size, IN6_PKTINFO.size))


class DatagramSource(tuple[Any, ...]):
    """
    The address that a datagram came from.

    Attributes:
        control: control data for the answer, which choose the address that was asked.
    """

    control: list[tuple[int, int, bytes]]


class AllAddresses(socket.socket):
    """A UDP socket that is bound to all addresses of this machine."""

    def recvfrom(self, *arguments: int) -> tuple[bytes, DatagramSource]:
        """Return a datagram, and the address for `sendto`. Raises OSError."""
        data, control, _, address = self.recvmsg(arguments[0], ROOM)
        source = DatagramSource(address)
        source.control = [_choice(*each) for each in control]
        return data, source

    def sendto(self, data: Any, *arguments: Any) -> int:
        """Send an answer to an address of `recvfrom`. Raises OSError."""
        (source,) = arguments
        return self.sendmsg([data], source.control, 0, source)


@lru_cache(64)
def _choice(level: int, kind: int, info: bytes) -> tuple[int, int, bytes]:
    """Return the control data that answer what came with these."""
    # Interface 0 is any. Another one overrides the routes, though the client may be elsewhere.
    if level == socket.IPPROTO_IP:
        _, own, target = IN_PKTINFO.unpack(info)
        return level, kind, IN_PKTINFO.pack(0, own, target)
    own, interface = IN6_PKTINFO.unpack(info)
    address = IPv6Address(own)
    if address.is_multicast:  # no address of this machine: the system chooses one
        own = bytes(16)
    return level, kind, IN6_PKTINFO.pack(own, interface if address.is_link_local else 0)


def bound_datagrams(family: socket.AddressFamily, address: tuple[Any, ...]) -> socket.socket:
    """
    Return a UDP socket that is bound to an address.

    Raises:
        OSError: the address cannot be bound.
    """
    has_all = ip_address(address[0].partition("%")[0]).is_unspecified
    made = (AllAddresses if has_all else socket.socket)(family, socket.SOCK_DGRAM)
    try:
        if family == socket.AF_INET6:
            made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        if has_all and family == socket.AF_INET6:
            made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_RECVPKTINFO, 1)
        elif has_all:
            made.setsockopt(socket.IPPROTO_IP, IP_PKTINFO, 1)
        made.bind(address)
    except OSError:
        made.close()
        raise
    return made
