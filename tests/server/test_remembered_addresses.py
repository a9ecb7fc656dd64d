"""
Addresses of clients that are remembered without a connection: the latest, and not for ever.
"""

from __future__ import annotations

import asyncio
import math

import pytest

from libmodbus_py.server import limits as module
from libmodbus_py.server.limits import Address, Addresses
from tests.simulation.network import Network


class Client:
    """A connection that waits until its address may send again."""

    def __init__(self, address: Address[Client], asks: int = 1) -> None:
        self.address = address
        self.asks = asks
        self.resumed: list[float] = []

    def resume(self) -> None:
        self.resumed.append(asyncio.get_running_loop().time())
        self.address.spend(self.asks)


def overspent(addresses: Addresses[Client], host: str) -> Address[Client]:
    address = addresses.get(host)
    address.spend(1000)
    addresses.keep(address)
    return address


def test_the_latest_addresses_are_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REMEMBERED_MAX", 3)

    async def main() -> None:
        addresses: Addresses[Client] = Addresses(1.0)
        for last in (1, 2, 3):
            overspent(addresses, f"192.0.2.{last}")
        addresses.keep(addresses.get("192.0.2.1"))  # it came again
        overspent(addresses, "192.0.2.4")
        known = [last for last in range(1, 5) if addresses.get(f"192.0.2.{last}").is_overspent()]
        assert known == [1, 3, 4]

    Network().run(main)


def test_an_address_with_a_connection_is_remembered_whatever_comes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "REMEMBERED_MAX", 1)

    async def main() -> None:
        addresses: Addresses[Client] = Addresses(1.0)
        connected = addresses.get("192.0.2.1")
        client = Client(connected)
        connected.connections[client] = None
        connected.spend(1000)
        addresses.keep(connected)
        for last in range(2, 9):
            overspent(addresses, f"192.0.2.{last}")
        assert addresses.get("192.0.2.1") is connected
        connected.forget(client)
        addresses.keep(connected)
        assert addresses.get("192.0.2.1") is connected  # its connection is gone, its limit not
        overspent(addresses, "192.0.2.9")
        assert addresses.get("192.0.2.1") is not connected

    Network().run(main)


def test_without_a_limit_only_connected_addresses_are_remembered() -> None:
    async def main() -> None:
        addresses: Addresses[Client] = Addresses(math.inf)
        address = addresses.get("192.0.2.1")
        addresses.keep(address)
        assert addresses.get("192.0.2.1") is not address
        address.connections[Client(address)] = None
        addresses.keep(address)
        assert addresses.get("192.0.2.1") is address

    Network().run(main)


def test_paused_connections_go_on_one_by_one() -> None:
    """Each waits for what the one before asks, which may be nothing."""

    async def main() -> None:
        address: Address[Client] = Address("192.0.2.1", 10.0, asyncio.get_running_loop())
        address.spend(30)  # twice what it may at once: it waits for two seconds
        clients = [Client(address, asks) for asks in (5, 1, 0, 1, 1)]
        for each in clients:
            address.pause(each)
        address.forget(clients[1])
        begun = asyncio.get_running_loop().time()
        await asyncio.sleep(10)
        times = [at - begun for each in clients for at in each.resumed]
        assert times == pytest.approx([2.0, 2.5, 2.5, 2.6], abs=0.001)
        assert clients[1].resumed == []

    Network().run(main)


def test_an_address_whose_last_paused_connection_is_gone_waits_for_none() -> None:
    async def main() -> None:
        address: Address[Client] = Address("192.0.2.1", 1.0, asyncio.get_running_loop())
        address.spend(3)
        gone, late = Client(address), Client(address)
        address.pause(gone)
        address.forget(gone)
        await asyncio.sleep(1)
        address.pause(late)
        await asyncio.sleep(5)
        assert gone.resumed == []
        assert len(late.resumed) == 1

    Network().run(main)
