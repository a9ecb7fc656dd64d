"""How many connections a server has, of all clients and of one address, and who goes for others."""

import pytest

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.server.limits import Limits
from tests.simulation.lan import Lan
from tests.support.attacks import READ_ONE, adu, connect, descriptor_limit, receive
from tests.support.lan_server import ANSWER_ONE, ONE_ANSWER, OTHER, OVER_TCP, ask, server_on
from tests.support.names import NEEDS_IPV6

KIND = pytest.mark.parametrize("kind", OVER_TCP)


def test_connections_are_limited_by_free_descriptors() -> None:
    with descriptor_limit(200):
        assert 1 <= Limits().connections() < 200
    with descriptor_limit(20):
        assert Limits().connections() == 1
    assert Limits(max_connections=7).connections() == 7


@KIND
def test_a_full_server_closes_silent_and_then_idle_clients(lan: Lan, kind: str) -> None:
    with server_on(lan, kind, max_connections=3) as server:
        first, second, stranger = (server.connect() for _ in range(3))
        ask(first)
        ask(second)
        lan.pass_time(0.1)
        ask(first)  # now the second one is the longest idle

        third = server.connect()
        ask(third)
        assert stranger.is_closed()
        ask(server.connect())
        assert second.is_closed()
        ask(first)
        ask(third)
        assert server.counts(connections=3, accepted=5, closed_for_others=2, refused_full=0)


@KIND
def test_a_full_server_may_refuse_new_connections(lan: Lan, kind: str) -> None:
    with server_on(lan, kind, max_connections=2, when_full="refuse") as server:
        first, second = server.connect(), server.connect()
        ask(first)
        ask(second)
        assert server.refuses()
        ask(first)
        ask(second)
        assert server.counts(connections=2, accepted=2, closed_for_others=0, refused_full=1)
        first.close()
        assert server.counts(connections=1)
        ask(server.connect())


def test_endpoints_share_their_connections(lan: Lan) -> None:
    server = Server(Device(Mapping()), limits=Limits(max_connections=1))
    with server.background("tcp://10.0.0.1:0", "rtu+tcp://10.0.0.1:0") as running:
        first = lan.client(running.urls[0])
        lan.pass_time(0.01)
        lan.client(running.urls[1])
        assert first.is_closed()
    assert server.statistics.closed_for_others == 1


def test_connections_left_at_the_end_are_closed(lan: Lan) -> None:
    with server_on(lan) as server:
        connection = server.connect()
        ask(connection)
    assert connection.is_closed()
    assert server.statistics.connections == 0


@KIND
def test_an_address_at_its_limit_loses_its_own_oldest_connection(lan: Lan, kind: str) -> None:
    with server_on(lan, kind, max_connections=6, connections_per_address=3) as server:
        others = [server.connect(OTHER) for _ in range(3)]
        ask(others[0])
        assert server.counts(connections=3)
        first, second, stranger = (server.connect() for _ in range(3))
        ask(first)
        ask(second)
        for number in range(20):
            newcomer = server.connect()
            assert stranger.is_closed()
            stranger = newcomer
            assert server.counts(connections=6, closed_for_others=1 + number)
        ask(stranger)
        ask(server.connect())
        assert first.is_closed()
        for other in others:  # two of them are strangers, who would have gone first
            ask(other)
        assert server.counts(connections=6, refused_full=0, refused_address=0)


@KIND
def test_an_address_at_its_limit_may_be_refused(lan: Lan, kind: str) -> None:
    with server_on(lan, kind, connections_per_address=2, when_full="refuse") as server:
        first, second = server.connect(), server.connect()
        ask(first)
        ask(second)
        for _ in range(3):
            assert server.refuses()
        other = server.connect(OTHER)
        ask(other)
        other.close()
        ask(first)
        assert server.counts(connections=2, refused_address=3, refused_full=0, closed_for_others=0)
        second.close()
        assert server.counts(connections=1)
        ask(server.connect())


def test_an_ipv4_address_in_ipv6_notation_is_the_same_address(lan: Lan) -> None:
    """As a listener for both families would say it."""
    with server_on(lan, connections_per_address=1, when_full="refuse") as server:
        ask(server.connect("192.0.2.7"))
        assert server.refuses("::ffff:192.0.2.7")
        ask(server.connect("::ffff:192.0.2.8"))
        ask(server.connect("::192.0.2.7"))
        assert server.counts(refused_address=1)


@KIND
def test_hosts_outside_the_networks_are_closed_at_once(lan: Lan, kind: str) -> None:
    with server_on(lan, kind, allow=["127.0.0.2", "127.1.0.0/16"]) as server:
        for source in ("127.0.0.1", "127.0.0.3"):
            assert server.refuses(source)
        for source in ("127.0.0.2", "127.1.2.3"):
            with server.connect(source) as inside:
                ask(inside)
        assert server.counts(connections=0, accepted=2, disallowed=2)


@NEEDS_IPV6
@pytest.mark.parametrize(("allow", "is_allowed"), [("::1", True), ("2001:db8::/32", False)])
def test_only_the_listed_ipv6_hosts_are_served(allow: str, is_allowed: bool) -> None:
    server = Server(Device(Mapping(holding_registers=1)), limits=Limits(allow=[allow]))
    with server.background("tcp://[::1]:0") as running, connect(running.urls[0]) as connection:
        if is_allowed:
            connection.sendall(adu(READ_ONE))
            assert receive(connection, ONE_ANSWER) == adu(ANSWER_ONE)
        else:
            assert connection.recv(1) == b""
    assert server.statistics.disallowed == (not is_allowed)
