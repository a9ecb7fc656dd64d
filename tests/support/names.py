"""
Host names that resolve in this process alone, for no test asks a name server, or /etc/hosts; and
whether this machine has ::1, which not every container has.
"""

import socket
from typing import Any

import pytest


def _has_ipv6() -> bool:
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        return False
    return True


NEEDS_IPV6 = pytest.mark.skipif(not _has_ipv6(), reason="this machine has no ::1")
"""The mark of tests, and of parameters, that talk over ::1."""


def resolve(monkeypatch: pytest.MonkeyPatch, name: str, *addresses: str) -> None:
    """Let a host name stand for addresses, or for 127.0.0.1, until the test ends."""
    look_up = socket.getaddrinfo

    def getaddrinfo(
        host: Any, port: Any, family: int = 0, type: int = 0, proto: int = 0, flags: int = 0
    ) -> list[Any]:
        is_name = host == name and not flags & socket.AI_NUMERICHOST
        hosts = (addresses or ("127.0.0.1",)) if is_name else (host,)
        return [entry for at in hosts for entry in look_up(at, port, family, type, proto, flags)]

    monkeypatch.setattr(socket, "getaddrinfo", getaddrinfo)
