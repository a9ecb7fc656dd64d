"""
Hosts that are this machine.
"""

from __future__ import annotations

import socket
from functools import lru_cache
from ipaddress import IPv6Address, ip_address

__all__ = ["EVERYWHERE", "is_loopback", "is_this_machine"]

LOCALHOST = ("localhost", "ip6-localhost")

EVERYWHERE = ("0.0.0.0", "::")
"""Hosts at which a server listens on all addresses of its machine."""


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
