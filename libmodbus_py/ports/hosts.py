"""
Hosts and ports as text, and hosts that are this machine.
"""

from __future__ import annotations

import re
import socket
from functools import lru_cache

# fmt: off
__all__ = [
    "EVERYWHERE", "host_and_port", "host_of_peer", "is_loopback", "is_this_machine",
    "split_host_and_port",
]
# fmt: on

LOCALHOST = ("localhost", "ip6-localhost")

EVERYWHERE = ("0.0.0.0", "::")
"""Hosts at which a server listens on all addresses of its machine."""


# The second form is an IPv6 address without brackets, which no port can follow.
HOST_AND_PORT = re.compile(
    r"\[(?P<address>[^\[\]\s]+)\](?::(?P<a>[0-9]{1,5}))?"
    r"|(?P<bare>[^/\[\]@\s]*:[^/\[\]@\s]*:[^/\[\]@\s]*)"
    r"|(?P<name>[^:/\[\]@\s]+)(?::(?P<b>[0-9]{1,5}))?"
)


def host_and_port(host: str, port: int) -> str:
    """Return a host and its port as text, such as "192.0.2.1:502" or "[::1]:502"."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def split_host_and_port(text: str) -> tuple[str, int | None]:
    """
    Return the host and the port of a text such as "192.0.2.1:502", "[::1]:502" or "::1".

    Returns:
        The host without brackets, and the port; None if the text has none.

    Raises:
        ValueError: the text is no host with a port or without one, or the port is not in 0..65535.
    """
    found = HOST_AND_PORT.fullmatch(text)
    if found is None:
        raise ValueError(f"must be HOST or HOST:PORT, not {text!r}")
    port = found["a"] or found["b"]
    if port is not None and int(port) > 65535:
        raise ValueError(f"the port must be in 0..65535, not {port}")
    return found["address"] or found["bare"] or found["name"], None if port is None else int(port)


def host_of_peer(peer: str) -> str:
    """
    Return the host in the name of a client of a server; other names are returned as they are.

    Args:
        peer: as `host_and_port` returns it, or the path of a serial port.
    """
    return peer if peer.startswith("/") else peer.rpartition(":")[0].strip("[]")


@lru_cache(1024)
def is_loopback(host: str) -> bool:
    """
    Return True if only this machine reaches a host, and no other one can pretend to be it.

    Args:
        host: an address, of any IPv6 zone, or a name; names other than localhost are not
            looked up.
    """
    host = host.lower().partition("%")[0]
    if host in LOCALHOST:
        return True
    if host.startswith("127."):  # also in the short forms that the system takes, such as 127.1
        return host.replace(".", "").isdigit()
    from ipaddress import IPv6Address, ip_address

    try:
        address = ip_address(host)
    except ValueError:
        return False
    mapped = address.ipv4_mapped if isinstance(address, IPv6Address) else None
    return (mapped or address).is_loopback


def is_this_machine(host: str) -> bool:
    """
    Return True if a host is this machine: loopback, `EVERYWHERE`, or the address of an interface.

    Args:
        host: as for `is_loopback`.
    """
    if host in EVERYWHERE or is_loopback(host):
        return True
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.inet_pton(family, host)
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.bind((host, 0))
    except OSError:
        return False
    return True
