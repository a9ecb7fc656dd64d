"""
Clients that connect from an address of this machine, and from a port of their own.
"""

import errno
import socket
from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import Client, Device, Mapping, ModbusConnectionError, Server
from libmodbus_py.ports.hosts import own_address
from tests.support.cases import each_case
from tests.support.certificates import Papers
from tests.support.clients import ALL, asking

TRANSPORTS = ["tcp", "tls", "udp", "rtu+tcp", "rtu+udp"]


@pytest.fixture
def free() -> int:
    """A port that is free on 127.0.0.2."""
    with socket.create_server(("127.0.0.2", 0)) as bound:
        number: int = bound.getsockname()[1]
        return number


@pytest.fixture(params=TRANSPORTS)
def url(request: pytest.FixtureRequest, tmp_path: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    """The URL of a server, and the options that its clients need."""
    papers, is_secure = Papers(tmp_path), request.param == "tls"
    security = papers.server() if is_secure else None
    server = Server(Device(Mapping(holding_registers=1)), security=security)
    with server.background(f"{request.param}://127.0.0.1:0") as running:
        yield running.urls[0], {"security": papers.client()} if is_secure else {}


@ALL
def test_a_client_connects_from_its_source_and_again_at_once(
    kind: str, url: tuple[str, dict[str, Any]], free: int
) -> None:
    """An orderly end of a TCP connection would keep its port for a minute."""
    at, options = url
    for _ in range(3):
        with asking(kind, at, source=f"127.0.0.2:{free}", **options) as plc:
            assert plc._driver._port._socket.getsockname() == ("127.0.0.2", free)
            assert plc.read_holding_registers(0, 1) == [0]
    with asking(kind, f"{at}?source=127.0.0.3", **options) as plc:
        assert plc._driver._port._socket.getsockname()[0] == "127.0.0.3"
        assert plc.read_holding_registers(0, 1) == [0]


@each_case(
    ("source", "number"),
    [("192.0.2.5", errno.EADDRNOTAVAIL), ("::1", errno.EAFNOSUPPORT)],
)
def test_a_source_that_cannot_reach_the_host_is_named(source: str, number: int) -> None:
    with pytest.raises(ModbusConnectionError, match=f"\\(from .*{source}.*:0\\)") as caught:
        Client("tcp://127.0.0.1:1", source=source).connect()
    assert caught.value.errno == number


def test_a_source_port_that_is_taken_is_named() -> None:
    with socket.create_server(("127.0.0.2", 0)) as bound:
        source = f"127.0.0.2:{bound.getsockname()[1]}"
        with pytest.raises(ModbusConnectionError, match=f"\\(from {source}\\)") as caught:
            Client("tcp://127.0.0.1:1", source=source).connect()
    assert caught.value.errno == errno.EADDRINUSE


@each_case(
    ("url", "source", "text"),
    [
        ("tcp://h", 40000, "source must be a string, not int"),
        ("tcp://h", "plc.example:40000", "source must be an address of this machine"),
        ("tcp://h", "127.0.0.1:65536", "the port must be in 0..65535"),
        ("rtu:///dev/ttyUSB0", "127.0.0.1", "source is for hosts, not for rtu://"),
        ("unix:///run/x", "127.0.0.1", "source is for hosts, not for unix://"),
    ],
)
def test_what_is_no_source_is_refused(url: str, source: Any, text: str) -> None:
    with pytest.raises((TypeError, ValueError), match=text):
        Client(url, source=source)


def test_addresses_may_have_a_port_and_a_zone() -> None:
    assert own_address("source", "192.0.2.5:40000") == (socket.AF_INET, ("192.0.2.5", 40000))
    assert own_address("source", "fe80::1%lo") == (socket.AF_INET6, ("fe80::1%lo", 0))
    assert own_address("source", "[::1]:7") == (socket.AF_INET6, ("::1", 7))
