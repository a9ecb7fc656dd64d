"""Where servers listen, and what a client says first."""

import errno
import socket
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from ipaddress import IPv6Address
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py import Client, Device, Mapping, Server
from libmodbus_py.listen import listen
from libmodbus_py.page import live_page
from libmodbus_py.ports.hosts import listen_on
from libmodbus_py.ports.listening import Greeting
from libmodbus_py.ports.options import greeting_of
from tests.support.cases import each_case
from tests.support.driver import rtu
from tests.support.golden import Refused
from tests.support.names import resolve

HERE = ["127.1.2.3", "127.1.2.4"]


@pytest.fixture
def port() -> int:
    """A port that is free on both addresses."""
    with socket.create_server((HERE[0], 0)) as one:
        number: int = one.getsockname()[1]
        with socket.create_server((HERE[1], number)):
            return number


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
def test_connections_are_accepted_on_every_address_of_a_name(monkeypatch, port: int, listening):
    resolve(monkeypatch, "plc.example", *HERE)
    with listening(port):
        for entry in HERE:
            with socket.create_connection((entry, port), 20) as connection:
                assert connection.getpeername() == (entry, port)


def test_a_page_answers_on_every_address(monkeypatch: pytest.MonkeyPatch, port: int) -> None:
    resolve(monkeypatch, "plc.example", *HERE)
    with live_page(Server(Device(Mapping(1))), host="plc.example", port=port) as page:
        for entry in HERE:
            with urllib.request.urlopen(page.url.replace("plc.example", entry), timeout=20) as file:
                assert file.status == 200


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
def test_a_server_listens_on_an_address_with_a_zone(scheme: str) -> None:
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
def test_an_address_of_another_machine_is_left_out_beside_others(monkeypatch, port: int) -> None:
    resolve(monkeypatch, "plc.example", "192.0.2.1", HERE[0])
    (listener,) = listen_on("plc.example", port)
    with listener:
        assert listener.getsockname() == (HERE[0], port)


@pytest.mark.usefixtures("only_here")
def test_a_server_without_any_address_of_this_machine_is_an_error(monkeypatch: pytest.MonkeyPatch):
    resolve(monkeypatch, "plc.example", "192.0.2.1", "192.0.2.2")
    with pytest.raises(OSError, match="assign") as caught:
        listen_on("plc.example", 0)
    assert caught.value.errno == errno.EADDRNOTAVAIL


def test_a_port_that_is_taken_on_one_address_is_free_on_the_others_again(monkeypatch, port: int):
    resolve(monkeypatch, "plc.example", *HERE)
    with socket.create_server((HERE[1], port)):
        with pytest.raises(OSError, match="in use"):
            listen_on("plc.example", port)
        socket.create_server((HERE[0], port)).close()


@each_case("host", ["a..b", "x" * 64 + ".example"])
def test_an_invalid_host_is_an_os_error(host: str) -> None:
    with pytest.raises(OSError, match="it cannot be the name of a host"):
        listen_on(host, 0)


IMEI = b"865123456789012"
HEARTBEAT = b"www.usr.cn"
MBAP = bytes.fromhex("000100000005 11 03 02 022B")  # the answer 555 of unit 17
LONG = bytes.fromhex("0002000000FB 11 03 F8") + IMEI * 16 + bytes(8)  # a text as the greeting
RTU = rtu("11 03 02 022B")


@each_case(
    ("text", "greeting"),
    [
        ("20 bytes", (20, ())),
        ("1 byte", (1, ())),
        ("20bytes", (20, ())),
        ("865123456789012", (0, (IMEI,))),
        ("20 bytes,www.usr.cn", (20, (HEARTBEAT,))),
        ("0x0123456789,ping", (0, (bytes.fromhex("0123456789"), b"ping"))),
        ("Zähler", (0, ("Zähler".encode(),))),
    ],
)
def test_a_greeting_is_parsed_into_its_items(text: str, greeting: Any) -> None:
    assert greeting_of("greeting", text) == greeting


def test_an_invalid_greeting_is_refused(refused: Refused) -> None:
    refused("wrong_greetings.txt", lambda text: greeting_of("greeting", text))


def frames(greeting: Greeting, data: bytes, size: int) -> bytes:
    greeting.begin()
    pieces = [data[at : at + size] for at in range(0, len(data), size)]
    return b"".join(map(greeting.drop, pieces))


@given(st.lists(st.sampled_from([IMEI, HEARTBEAT, MBAP, LONG]), max_size=6), st.integers(1, 300))
def test_heartbeats_between_frames_with_a_header_are_dropped(parts: list[bytes], size: int) -> None:
    """Also from the middle of what was received together; a frame may contain such a text."""
    greeting = Greeting(0, (IMEI, HEARTBEAT), has_header=True)
    data = b"".join(part for part in parts if part in (MBAP, LONG))
    assert frames(greeting, b"".join(parts), size) == data


@each_case("chunks", [[IMEI, RTU], [IMEI + RTU], [RTU + HEARTBEAT], [IMEI[:4], IMEI[4:], RTU]])
def test_heartbeats_around_a_frame_of_a_line_are_dropped(chunks: list[bytes]) -> None:
    greeting = Greeting(0, (IMEI, HEARTBEAT), has_header=False)
    assert b"".join(map(greeting.drop, chunks)) == RTU


def test_an_answer_of_a_line_in_pieces_is_passed_on() -> None:
    greeting = Greeting(0, (IMEI, HEARTBEAT), has_header=False)
    assert frames(greeting, RTU, 1) == RTU


@each_case("size", [1, 7, 20, 100])
def test_the_first_bytes_of_each_connection_are_dropped(size: int) -> None:
    greeting = Greeting(20, (), has_header=True)
    for _ in range(2):
        assert frames(greeting, bytes(20) + MBAP, size) == MBAP


def test_a_frame_may_begin_after_bytes_that_are_no_frame() -> None:
    greeting = Greeting(0, (HEARTBEAT,), has_header=True)
    greeting.drop(b"hello, this is no frame")
    greeting.expect_frame()
    assert greeting.drop(HEARTBEAT + MBAP) == MBAP


def test_heartbeats_may_follow_the_dropped_first_bytes() -> None:
    greeting = Greeting(20, (HEARTBEAT,), has_header=True)
    assert frames(greeting, bytes(20) + HEARTBEAT + MBAP + HEARTBEAT, 64) == MBAP
