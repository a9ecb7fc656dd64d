"""
Sockets to listen on: each thing that listens does so on all addresses of a name.
"""

import errno
import socket
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from ipaddress import IPv6Address
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Client, Device, Mapping, Server
from libmodbus_py.listen import listen
from libmodbus_py.page import live_page
from libmodbus_py.ports.hosts import listen_on
from tests.support.cases import each_case
from tests.support.names import resolve

HERE = ["127.1.2.3", "127.1.2.4"]


@pytest.fixture
def port() -> int:
    """A port that is free on both addresses."""
    with socket.create_server((HERE[0], 0)) as one:
        found: int = one.getsockname()[1]
        with socket.create_server((HERE[1], found)):
            return found


@contextmanager
def serving(port: int) -> Iterator[None]:
    with Server(Device(Mapping(1))).background(f"tcp://plc.example:{port}"):
        yield


@contextmanager
def tapping(port: int) -> Iterator[None]:
    url = f"rtu+tcp://plc.example:{port}"
    with listen(url, between="rtu+tcp://127.0.0.1:1"):
        yield


@contextmanager
def exposing(port: int) -> Iterator[None]:
    prometheus = pytest.importorskip("libmodbus_py.services.integrations.prometheus")
    with prometheus.exposing("plc.example", port):
        yield


@pytest.mark.parametrize("listening", [serving, tapping, exposing])
def test_every_address_of_a_name_takes_connections(
    monkeypatch: pytest.MonkeyPatch,
    port: int,
    listening: Callable[[int], AbstractContextManager[None]],
) -> None:
    resolve(monkeypatch, "plc.example", *HERE)
    with listening(port):
        for each in HERE:
            with socket.create_connection((each, port), 20) as made:
                assert made.getpeername() == (each, port)


def test_a_page_answers_on_every_address(monkeypatch: pytest.MonkeyPatch, port: int) -> None:
    resolve(monkeypatch, "plc.example", *HERE)
    with live_page(Server(Device(Mapping(1))), host="plc.example", port=port) as page:
        for each in HERE:
            with urllib.request.urlopen(page.url.replace("plc.example", each), timeout=20) as got:
                assert got.status == 200


def local_addresses() -> list[str]:
    """Return the link-local addresses of this machine, which need the zone of their interface."""
    try:
        lines = [line.split() for line in Path("/proc/net/if_inet6").read_text().splitlines()]
    except OSError:
        return []
    return [
        f"{IPv6Address(int(digits, 16))}%{interface}"
        for digits, _, _, scope, _, interface in lines
        if scope == "20"
    ]


@pytest.mark.skipif(not local_addresses(), reason="no interface has a link-local address")
@pytest.mark.parametrize("scheme", ["tcp", "udp"])
def test_an_address_with_a_zone_can_be_listened_at(scheme: str) -> None:
    url = f"{scheme}://[{local_addresses()[0]}]:0"
    with (
        Server(Device(Mapping(1))).background(url) as running,
        Client(running.urls[0], timeout=20) as client,
    ):
        assert client.read_coils(0, 1) == [False]


@pytest.fixture
def only_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some systems bind addresses that they do not have."""
    create = socket.create_server

    def create_server(address: tuple[str, int], **options: Any) -> socket.socket:
        if address[0].startswith("192.0.2."):
            raise OSError(errno.EADDRNOTAVAIL, "Cannot assign requested address (while ...)")
        return create(address, **options)

    monkeypatch.setattr(socket, "create_server", create_server)


@pytest.mark.usefixtures("only_here")
def test_an_address_of_another_machine_is_left_out_beside_others(
    monkeypatch: pytest.MonkeyPatch, port: int
) -> None:
    resolve(monkeypatch, "plc.example", "192.0.2.1", HERE[0])
    (made,) = listen_on("plc.example", port)
    with made:
        assert made.getsockname() == (HERE[0], port)


@pytest.mark.usefixtures("only_here")
def test_no_address_of_this_machine_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    resolve(monkeypatch, "plc.example", "192.0.2.1", "192.0.2.2")
    with pytest.raises(OSError, match="assign") as caught:
        listen_on("plc.example", 0)
    assert caught.value.errno == errno.EADDRNOTAVAIL


def test_a_port_that_is_taken_on_one_address_is_free_on_the_others_again(
    monkeypatch: pytest.MonkeyPatch, port: int
) -> None:
    resolve(monkeypatch, "plc.example", *HERE)
    with socket.create_server((HERE[1], port)):
        with pytest.raises(OSError, match="in use"):
            listen_on("plc.example", port)
        socket.create_server((HERE[0], port)).close()


@each_case("host", ["a..b", "x" * 64 + ".example"])
def test_a_host_that_cannot_be_is_an_os_error(host: str) -> None:
    with pytest.raises(OSError, match="it cannot be the name of a host"):
        listen_on(host, 0)
