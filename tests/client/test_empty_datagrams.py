"""
Datagrams without a byte: anybody can send them, and they say nothing.
"""

from __future__ import annotations

from typing import Any

import pytest

from libmodbus_py import ModbusTimeoutError
from tests.support.clients import ALL, asking, read
from tests.support.peers import UdpPeer, Write, answer

SCHEMES = pytest.mark.parametrize("scheme", ["udp", "rtu+udp"])

COUNTED = ("late_answers", "invalid", "lost", "connects", "timeouts")


def counted(client: Any) -> dict[str, int]:
    return {name: getattr(client.statistics, name) for name in COUNTED}


class Empties:
    """Answers a request as its address says: with so many empty datagrams, and then the answer."""

    def __init__(self, scheme: str) -> None:
        self._scheme = scheme

    def __call__(self, request: bytes, write: Write) -> None:
        for _ in range(3):
            write(b"")
        write(answer(request, self._scheme))


@SCHEMES
@ALL
def test_those_before_an_answer_are_no_answer(kind: str, scheme: str) -> None:
    with UdpPeer(Empties(scheme), scheme) as peer, asking(kind, peer.url, timeout=30) as client:
        assert [read(client, address) for address in range(20)] == list(range(20))
        assert counted(client) == dict.fromkeys(COUNTED, 0) | {"connects": 1}


@SCHEMES
@ALL
def test_those_that_come_to_an_idle_client_change_nothing(kind: str, scheme: str) -> None:
    """Neither its connection nor the rest that a unit without an answer gets."""
    is_silent = False

    def on_request(request: bytes, write: Write) -> None:
        if not is_silent:
            write(answer(request, scheme))

    with UdpPeer(on_request, scheme) as peer, asking(kind, peer.url, timeout=0.1) as client:
        assert read(client, 0) == 0
        is_silent = True
        with pytest.raises(ModbusTimeoutError):
            read(client, 1)
        before = counted(client)
        for _ in range(100):
            peer._socket.sendto(b"", peer.clients[0])
        is_silent = False
        assert read(client.for_unit(1, timeout=30), 2) == 2
        assert counted(client) == before
