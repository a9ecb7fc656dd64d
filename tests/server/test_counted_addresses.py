"""What counts as one address: in limits, rates and handshakes, and in the turns of a gateway."""

from __future__ import annotations

import asyncio

import pytest

from libmodbus_py.ports.hosts import host_and_port
from libmodbus_py.server import tls
from libmodbus_py.server.limits import (
    Address,
    Addresses,
    Limits,
    PausedConnection,
    ServerStatistics,
    counted_host,
    host_of,
)
from libmodbus_py.server.service import Session
from libmodbus_py.server.tls import Handshakes, TlsSession
from tests.support.cases import each_case
from tests.support.certificates import Pki
from tests.support.chunks import FakeChannel


@each_case(
    ("host", "network"),
    [
        ("192.0.2.7", "192.0.2.7"),
        ("::ffff:192.0.2.7", "192.0.2.7"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("2001:db8:1:2::", "2001:db8:1:2::/64"),
        ("2001:db8:1:3::", "2001:db8:1:3::/64"),
        ("::1", "::/64"),
        # All machines of a link have this /64.
        ("fe80::1%eth0", "fe80::1%eth0"),
        ("fe80::2%eth0", "fe80::2%eth0"),
    ],
)
def test_an_ipv6_address_counts_as_its_64(host: str, network: str) -> None:
    assert counted_host(host) == network
    assert host_of(host_and_port(host, 502)) == network


async def test_all_addresses_of_a_64_share_a_request_rate() -> None:
    addresses: Addresses[PausedConnection] = Addresses(2.0)
    for last in range(3):
        address = addresses.get(f"2001:db8::{last}")
        addresses.keep(address)
        address.spend(1)
    assert addresses.get("2001:db8::ffff").is_overspent()
    assert not addresses.get("2001:db8:0:1::1").is_overspent()


class Client(FakeChannel):
    """A connection whose handshake has begun."""

    def __init__(self, address: str) -> None:
        super().__init__()
        self.address = address
        self.is_closed = False

    def end(self) -> None:
        self.is_closed = True


def never(_: object) -> Session:
    raise AssertionError("no handshake ends here")


async def test_half_open_handshakes_of_one_address_do_not_displace_those_of_others(
    monkeypatch, pki: Pki
) -> None:
    monkeypatch.setattr(tls, "HALF_OPEN", 10)

    statistics = ServerStatistics()
    security = pki.server()
    handshakes = Handshakes(security, Limits(), statistics)
    sessions: list[TlsSession] = []

    def begin(address: str) -> Client:
        client = Client(address)
        session = TlsSession(client, handshakes, never)
        sessions.append(session)
        session.receive(b"\x16")
        return client

    innocent = begin("192.0.2.1:1000")
    crowd = [begin(f"2001:db8::{number:x}:1000") for number in range(30)]
    other = begin("192.0.2.2:1000")
    assert not innocent.is_closed
    assert not other.is_closed
    assert [peer.is_closed for peer in crowd] == [True] * 22 + [False] * 8
    assert statistics.closed_for_others == 22
    for session in sessions:
        session.close()
    assert (handshakes._count, handshakes._half_open, handshakes._line) == (0, {}, {})


def test_addresses_take_turns_with_their_handshakes(monkeypatch: pytest.MonkeyPatch, pki: Pki):
    stepped: list[str] = []
    monkeypatch.setattr(TlsSession, "take_step", lambda self: stepped.append(self.address))

    async def main() -> None:
        security = pki.server()
        handshakes = Handshakes(security, Limits(), ServerStatistics())
        hosts = ["192.0.2.1"] * 5 + ["192.0.2.2"]
        sessions = [
            TlsSession(Client(f"{host}:{port}"), handshakes, never)
            for port, host in enumerate(hosts)
        ]
        for session in sessions:
            session.receive(b"\x16")
        while len(stepped) < len(hosts):
            await asyncio.sleep(0)
        for session in sessions:
            session.close()

    asyncio.run(main())
    assert stepped[:3] == ["192.0.2.1:0", "192.0.2.2:5", "192.0.2.1:1"]


class Waiting:
    """A connection that waits until its address may send again."""

    def __init__(self, address: Address[Waiting], asks: int = 1) -> None:
        self.address = address
        self.asks = asks
        self.resumed: list[float] = []

    def resume(self) -> None:
        self.resumed.append(asyncio.get_running_loop().time())
        self.address.spend(self.asks)
