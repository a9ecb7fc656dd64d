"""
Each attack against a gateway, with a device behind it: an innocent client loses nothing and
gets only right values, and nothing of the attack is left.
"""

from collections.abc import Callable

import pytest

from libmodbus_py import (
    Client,
    Device,
    Gateway,
    GatewayTargetFailedToRespond,
    Limits,
    Mapping,
    Route,
    Server,
)
from tests.services.gateway.gates import small
from tests.simulation.attackers import Attackers, Innocent
from tests.simulation.lan import Lan
from tests.simulation.scripted import Scripted, Write
from tests.support.attacks import ATTACKS, UNIT, Attack
from tests.support.gateways import passage

OVER_TCP = [attack for attack in ATTACKS if attack.scheme == "tcp"]


@pytest.mark.parametrize("attack", OVER_TCP, ids=lambda attack: attack.name.replace(" ", "-"))
def test_a_client_waits_for_few_requests_of_a_flood(lan: Lan, attack: Attack) -> None:
    """Counted in requests to the device: a refused one costs it nothing."""
    device = Server({UNIT: Device(Mapping(holding_registers=2000))})
    with device.background("tcp://10.0.0.9:0") as behind:
        routes = [Route(f"{behind.urls[0]}?timeout=5")]
        gateway = Gateway(routes, limits=Limits(max_connections=1500))
        with gateway.background("tcp://10.0.0.1:0") as running:
            client = lan.client(running.urls[0])
            innocent = Innocent(lan, client, lambda: device.statistics.requests)
            assert innocent.poll(3).others == [0] * 3
            with Attackers(lan, attack, running.urls[0]) as attackers:
                assert lan.until(lambda: attackers.all_attack, 10)
                waited = innocent.poll(3, among=attackers)
            # Each host has one turn; what is in flight when it comes, and sent next, goes before.
            assert max(waited.others) <= 2 + attack.connections
            assert lan.until(lambda: gateway.statistics.connections == 1)
            assert innocent.poll(3).others == [0] * 3
            (line,) = gateway.traffic.lines.values()
            assert line.waiting == line.in_flight == 0


ANYTHING: dict[str, Callable[[bytes], bytes]] = {
    "another transaction": lambda request: b"\xff\xff\0\0\0\5\1\3\2\0\1",
    "another unit": lambda request: request[:2] + b"\0\0\0\5\2\3\2\0\1",
    "another function": lambda request: request[:2] + b"\0\0\0\5\1\4\2\0\1",
    "too much": lambda request: request[:2] + b"\0\0\0\7\1\3\4\0\1\0\1",
    "another protocol": lambda request: request[:2] + b"\0\1\0\5\1\3\2\0\1",
    "no frame": lambda request: b"\xff" * 300,
}


@pytest.mark.parametrize("what", ANYTHING)
def test_invalid_answers_of_a_device_are_not_forwarded(lan: Lan, what: str) -> None:
    """Invalid responses become exception 0B; unasked ones, and those for others, are dropped."""

    def answer(request: bytes, write: Write) -> None:
        is_second = len(device.requests) == 2
        write(ANYTHING[what](request) if is_second else request[:2] + b"\0\0\0\5\1\3\2\0\7")

    device = Scripted(lan, "tcp://10.0.0.9:0", answer)
    gateway = Gateway([Route(f"{device.url}?timeout=3&max_pause=1")])
    with (
        gateway.background("tcp://10.0.0.1:0") as running,
        Client(running.urls[0], unit=1, timeout=50) as context,
    ):
        assert context.read_holding_registers(0, 1) == [7]
        start = lan.now
        with pytest.raises(GatewayTargetFailedToRespond):
            context.read_holding_registers(0, 1)
        assert lan.now - start <= 3.01

        def answers_again() -> bool:
            try:
                return context.read_holding_registers(0, 1) == [7]
            except GatewayTargetFailedToRespond:
                lan.pass_time(1)
                return False

        assert any(answers_again() for _ in range(60))


def test_every_client_gets_answers_during_floods_from_many_connections(lan: Lan) -> None:
    """As much as goes on eight connections of a host, and one client that asks in turn."""
    request = b"\0\1\0\0\0\6\1\3\0\0\0\1"
    with (
        passage("tcp", "rtu", {1: small()}, lan=lan) as through,
        through.context(1, timeout=20) as context,
    ):
        floods = [lan.client(through.url, "10.0.0.2") for _ in range(8)]
        (line,) = through.gateway.traffic.lines.values()
        for _ in range(10):
            for flood in floods:
                flood.end.send(request * 100)
                while flood.has_input():
                    flood.recv(65_536)
            before = line.connection.requests
            assert context.read_holding_registers(0, 1) == [0]
            # The one on the line, one of each host, and its own.
            assert line.connection.requests - before <= 3
            assert line.waiting <= 8 * 16 + 16
        assert line.full > 0
