"""Names and addresses of hosts, and the address that a client comes from."""

import errno
import logging
import socket
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from libmodbus_py import Client, Device, Mapping, ModbusConnectionError, Server
from libmodbus_py.ports.hosts import (
    is_loopback,
    is_this_machine,
    own_address,
    split_host_and_port,
)
from libmodbus_py.ports.port import Outage
from tests.support.cases import each_case
from tests.support.certificates import Pki
from tests.support.clients import ALL, asking

LOOPBACK = ["localhost", "LOCALHOST", "ip6-localhost", "127.0.0.1", "127.255.0.9", "127.1"]
LOOPBACK += ["::1", "::1%lo", "::ffff:127.0.0.1"]

OTHERS = ["192.0.2.1", "2001:db8::1", "::ffff:192.0.2.1", "fe80::1%eth0", "128.0.0.1", ""]
OTHERS += ["plant.example", "127.example", "localhost.example"]


@each_case("host", LOOPBACK)
def test_only_this_machine_reaches_loopback(host: str) -> None:
    assert is_loopback(host)
    assert is_this_machine(host)


@each_case("host", OTHERS)
def test_addresses_of_other_machines_are_not_local(host: str) -> None:
    assert not is_loopback(host)
    assert not is_this_machine(host)


@each_case("host", ["0.0.0.0", "::"])
def test_a_wildcard_address_is_local_but_no_loopback(host: str) -> None:
    assert is_this_machine(host)
    assert not is_loopback(host)


@each_case(
    ("text", "host", "port"),
    [
        ("192.0.2.1", "192.0.2.1", None),
        ("plc.example:1502", "plc.example", 1502),
        ("[::1]:0", "::1", 0),
        ("[fe80::1%eth0]", "fe80::1%eth0", None),
        ("::1", "::1", None),
        ("::1:502", "::1:502", None),
        ("h:65535", "h", 65535),
    ],
)
def test_a_text_has_a_host_and_may_have_a_port(text: str, host: str, port: int | None) -> None:
    assert split_host_and_port(text) == (host, port)


WRONG = ["", ":", ":502", "h:", "h:x", "h:65536", "h:-1", "[::1", "[::1]:", "[::1]x", "[]", "[]:1"]
WRONG += ["a b", "me@h", "h/x", "[::1]:1:2", "[[::1]]", "h:502\n", "h:\u0665"]


@each_case("text", WRONG)
def test_texts_that_are_no_host_and_port_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"must be"):
        split_host_and_port(text)


GONE = ModbusConnectionError("no such device", errno=19)


def failing() -> None:
    raise GONE


@pytest.fixture
def outage() -> Outage:
    return Outage(logging.getLogger("test"), "rtu:///dev/line")


def test_an_outage_is_logged_once_and_again_when_it_is_over(outage: Outage, caplog) -> None:
    for _ in range(2):
        for _ in range(3):
            outage.begin(GONE)
        assert outage.is_on
        for _ in range(2):
            outage.end()
        assert not outage.is_on
    messages = ["rtu:///dev/line: no such device; trying again", "rtu:///dev/line: open again"]
    assert caplog.messages == messages * 2


def test_an_outage_lasts_until_the_port_can_be_opened(outage: Outage, caplog) -> None:
    outage.begin(GONE)
    attempts: list[Callable[[], None]] = [failing, failing, lambda: None]
    assert [outage.try_to_end(attempt) for attempt in attempts] == [False, False, True]
    assert not outage.is_on
    assert len(caplog.messages) == 2


def test_other_errors_are_not_taken_for_a_missing_port(outage: Outage) -> None:
    def broken() -> None:
        raise RuntimeError

    outage.begin(GONE)
    with pytest.raises(RuntimeError):
        outage.try_to_end(broken)
    assert outage.is_on


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
    pki, is_secure = Pki(tmp_path), request.param == "tls"
    security = pki.server() if is_secure else None
    server = Server(Device(Mapping(holding_registers=1)), security=security)
    with server.background(f"{request.param}://127.0.0.1:0") as running:
        yield running.urls[0], {"security": pki.client()} if is_secure else {}


@ALL
def test_a_client_uses_its_source_address_also_right_after_a_close(
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


@each_case(("source", "number"), [("192.0.2.5", errno.EADDRNOTAVAIL), ("::1", errno.EAFNOSUPPORT)])
def test_a_source_that_cannot_reach_the_host_is_named(source: str, number: int) -> None:
    with pytest.raises(ModbusConnectionError, match=f"\\(from .*{source}.*:0\\)") as caught:
        Client("tcp://127.0.0.1:1", source=source).connect()
    assert caught.value.errno == number


def test_a_source_port_in_use_is_named() -> None:
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
def test_an_invalid_source_is_refused(url: str, source: Any, text: str) -> None:
    with pytest.raises((TypeError, ValueError), match=text):
        Client(url, source=source)


def test_addresses_may_have_a_port_and_a_zone() -> None:
    assert own_address("source", "192.0.2.5:40000") == (socket.AF_INET, ("192.0.2.5", 40000))
    assert own_address("source", "fe80::1%lo") == (socket.AF_INET6, ("fe80::1%lo", 0))
    assert own_address("source", "[::1]:7") == (socket.AF_INET6, ("::1", 7))
