"""
A server on all addresses of a machine answers datagrams from the address that was asked: a socket
that is connected to one address hears no other.
"""

import contextlib
import socket
from collections.abc import Iterator

import pytest

from libmodbus_py import Device, Fault, Gateway, Route, Server
from libmodbus_py.client.blocking import Client
from libmodbus_py.server.serving import Serving
from tests.support.clients import ALL, asking
from tests.support.names import NEEDS_IPV6

UNIT = 17
SCHEMES = pytest.mark.parametrize("scheme", ["udp", "rtu+udp"])
HOSTS = ("127.0.0.1", "127.0.0.2", "127.1.2.3")

# Not local to the loop of one machine: an address of an interface, for datagrams that go nowhere.
ELSEWHERE = ("fd00::1", "fe80::1", "2001:db8::1")


@contextlib.contextmanager
def served(serving: Serving, scheme: str, host: str = "0.0.0.0") -> Iterator[int]:
    with serving.background(f"{scheme}://{host}:0") as running:
        yield int(running.urls[0].rpartition(":")[2])


def values_of(scheme: str, host: str, port: int) -> list[int]:
    with Client(f"{scheme}://{host}:{port}", unit=UNIT, timeout=10) as client:
        return client.read_holding_registers(100, 2)


@SCHEMES
@ALL
def test_a_server_answers_on_every_address(kind: str, scheme: str, device: Device) -> None:
    with served(Server({UNIT: device}), scheme) as port:
        for host in HOSTS:
            url = f"{scheme}://{host}:{port}"
            with asking(kind, url, unit=UNIT, timeout=10, retries=0) as client:
                assert client.read_holding_registers(100, 2) == [1000, 1001]


@SCHEMES
def test_late_and_forwarded_answers_come_from_the_asked_address(scheme: str, device: Device):
    late = Server({UNIT: device}, faults={None: [Fault("delay", seconds=0.01)]})
    with late.background("tcp://127.0.0.1:0") as running:
        for serving in (late, Gateway([Route(running.urls[0])])):
            with served(serving, scheme) as port:
                for host in HOSTS:
                    assert values_of(scheme, host, port) == [1000, 1001]


def addresses_of_ipv6() -> list[str]:
    """Return those of this machine, as far as they show: ::1, and what it would send from."""
    hosts = ["[::1]"]
    for place in ELSEWHERE:
        sock = socket.socket(socket.AF_INET6, socket.SOCK_DGRAM)
        with sock, contextlib.suppress(OSError):
            sock.connect((place, 9))
            own = sock.getsockname()[0]
            if "%" not in own:
                hosts.append(f"[{own}]")
    return list(dict.fromkeys(hosts))


@NEEDS_IPV6
@SCHEMES
def test_a_server_answers_on_every_ipv6_address(scheme: str, device: Device) -> None:
    with served(Server({UNIT: device}), scheme, "[::]") as port:
        for host in addresses_of_ipv6():
            assert values_of(scheme, host, port) == [1000, 1001]


def test_a_datagram_to_all_nodes_is_answered_from_an_address_of_the_interface(device: Device):
    """A multicast address cannot be that of an answer (RFC 4291, 2.7)."""
    request = bytes.fromhex("0001 0000 0006 11 03 0064 0002")
    answer = bytes.fromhex("0001 0000 0007 11 03 04 03e8 03e9")
    with (
        served(Server({UNIT: device}), "udp", "[::]") as port,
        socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as client,
    ):
        client.settimeout(10)
        if not any(sent(client, request, port, entry) for entry, _ in socket.if_nameindex()):
            pytest.skip("no interface with a link-local address")
        data, source = client.recvfrom(1000)
        assert data == answer
        assert source[0].startswith("fe80:")


def sent(client: socket.socket, request: bytes, port: int, interface: int) -> bool:
    try:
        client.sendto(request, ("ff02::1", port, 0, interface))
    except OSError:
        return False
    return True


def test_empty_datagrams_are_ignored(device: Device) -> None:
    server = Server({UNIT: device})
    with served(server, "udp") as port, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        for _ in range(100):
            other.sendto(b"", ("127.0.0.1", port))
        assert values_of("udp", "127.0.0.1", port) == [1000, 1001]
    assert (server.statistics.requests, server.statistics.throttled) == (1, 0)
