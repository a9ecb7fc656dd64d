"""
Ranges of hosts that a scan tries, such as 192.0.2.0/24: which of them accept a connection.
"""

from __future__ import annotations

import re
import socket
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from ipaddress import ip_network

from ...ports.hosts import host_and_port
from ...ports.schemes import DEFAULT_PORT

__all__ = ["AT_ONCE", "host_range", "may_go_on"]

_MAX_HOSTS = 65_536
"""Hosts of a range, at most."""

_MANY_HOSTS = 1024
"""Hosts that are tried without a question, at most."""

AT_ONCE = 64
"""Hosts that are tried at the same time."""

_RANGE = re.compile(r"(?:tcp://)?\[?([0-9A-Fa-f.:]+/[0-9]{1,3})\]?(?::([0-9]{1,5}))?")


@dataclass(frozen=True)
class _HostRange:
    """The hosts of a network, and the port that is tried on each."""

    hosts: tuple[str, ...]
    port: int

    def listening(self, timeout: float) -> Iterator[str]:
        """Yield the URL of each host that accepts a connection within a time, in their order."""
        with ThreadPoolExecutor(AT_ONCE, "scan-host") as pool:
            try:
                tried = pool.map(lambda host: _accepts(host, self.port, timeout), self.hosts)
                for host, is_there in zip(self.hosts, tried, strict=True):
                    if is_there:
                        yield f"tcp://{host_and_port(host, self.port)}"
            finally:
                pool.shutdown(wait=True, cancel_futures=True)


def host_range(text: str) -> _HostRange | None:
    """
    Return the hosts of a range such as 192.0.2.0/24 or 192.0.2.0/24:1502; None for other text.

    Raises:
        ValueError: the range is wrong, or has too many hosts.
    """
    found = _RANGE.fullmatch(text)
    if found is None or "/" not in found[1]:
        return None
    try:
        network = ip_network(found[1], strict=False)
    except ValueError as error:
        raise ValueError(f"{text!r}: {error}") from None
    if network.num_addresses > _MAX_HOSTS:
        raise ValueError(
            f"{text!r} has {network.num_addresses} hosts, and a scan tries {_MAX_HOSTS} at most"
        )
    port = int(found[2] or DEFAULT_PORT)
    if not 1 <= port <= 65535:
        raise ValueError(f"{text!r}: the port must be in 1..65535")
    return _HostRange(tuple(map(str, network.hosts())), port)


def may_go_on(hosts: _HostRange, *, is_confirmed: bool) -> bool:
    """
    Return True if all these hosts may be tried; on a terminal, ask the user if there are many.

    Raises:
        ValueError: there are many hosts, and no terminal to ask at.
    """
    count = len(hosts.hosts)
    if count <= _MANY_HOSTS or is_confirmed:
        return True
    if not sys.stdin.isatty():
        raise ValueError(
            f"{count} hosts are more than {_MANY_HOSTS}: --yes tries them without a question"
        )
    print(f"try {count} hosts? [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _accepts(host: str, port: int, timeout: float) -> bool:
    try:
        socket.create_connection((host, port), timeout).close()
    except OSError:
        return False
    return True
