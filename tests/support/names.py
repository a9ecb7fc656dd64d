"""
Host names that resolve in this process alone: no test asks a name server, or /etc/hosts.
"""

from __future__ import annotations

import socket
from typing import Any

import pytest

__all__ = ["resolve"]


def resolve(monkeypatch: pytest.MonkeyPatch, name: str, address: str = "127.0.0.1") -> None:
    """Let a host name stand for an address, until the test ends."""
    look_up = socket.getaddrinfo

    def getaddrinfo(host: Any, *arguments: Any, **options: Any) -> list[Any]:
        return look_up(address if host == name else host, *arguments, **options)

    monkeypatch.setattr(socket, "getaddrinfo", getaddrinfo)
