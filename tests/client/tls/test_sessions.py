"""Contexts and sessions of TLS that several connections use."""

import contextlib
import ssl
import time
from typing import Any

import pytest

from libmodbus_py import Device, Mapping, ModbusConnectionError, Server
from libmodbus_py.security.security import GivenContext
from tests.support import certificates
from tests.support.certificates import Pki, expired
from tests.support.clients import Connect
from tests.support.peers import until
from tests.support.secured import context_of
from tests.support.tls import context
from tests.support.tls_clients import LONG, Talking
from tests.support.tls_peers import Peer, Relay, TlsServer


def once(peer: Peer) -> None:
    """Answer one request, and send close notify."""
    peer.answer()
    peer.sock.sendall(peer.end())


def abruptly(peer: Peer) -> None:
    """Answer one request, and close without close notify."""
    peer.answer()


def ask_after_each_end(plc: Any, server: TlsServer, times: int) -> None:
    """Ask, and ask again when the server has closed the connection."""
    for number in range(times):
        assert plc.read_holding_registers(number, 1) == [number]
        until(lambda: server.ended == server.connections)


@pytest.mark.parametrize("script", [once, abruptly])
def test_a_new_connection_resumes_the_session(talking: Talking, version: str, script) -> None:
    with talking(script, version=version) as (server, plc):
        ask_after_each_end(plc, server, 4)
    assert server.resumed == [False, True, True, True]


def test_a_server_may_forget_the_session(talking: Talking, pki: Pki, version: str) -> None:
    with talking(once, version=version) as (server, plc):
        for _ in range(3):
            ask_after_each_end(plc, server, 1)
            server.context = context_of(pki, certificates.server(), version)
    assert server.resumed == [False] * 3


def alerted(peer: Peer) -> None:
    """Answer one request, and send what cannot be decrypted: bad_record_mac is the answer."""
    peer.answer()
    peer.sock.sendall(b"\x17\x03\x03\0\x20" + bytes(32))
    peer.sock.recv(1000)


def test_no_session_outlives_an_alert(talking: Talking, version: str) -> None:
    """R-11."""
    with talking(alerted, version=version) as (server, plc):
        for _ in range(3):
            with contextlib.suppress(ModbusConnectionError):
                assert plc.read_holding_registers(0, 1) == [0]
    assert not any(server.resumed)
    assert len(server.resumed) >= 2


def test_no_session_outlives_a_failed_handshake(talking: Talking, version: str) -> None:
    with talking(once, version=version) as (server, plc):
        ask_after_each_end(plc, server, 1)
        talk, server._talk = server._talk, lambda sock: sock.recv(1)
        with pytest.raises(ModbusConnectionError, match="no TLS handshake"):
            plc.read_holding_registers(1, 1)
        server._talk = talk
        assert asking_again(plc) == [1]
    assert server.resumed == [False, False]


def asking_again(plc: Any) -> Any:
    """Until a connection stands again; the client pauses after failures."""
    end = time.monotonic() + LONG
    while True:
        try:
            return plc.read_holding_registers(1, 1)
        except ModbusConnectionError:
            assert time.monotonic() < end
            time.sleep(0.05)


def test_a_certificate_that_expired_meanwhile_is_not_resumed(
    talking: Talking, version: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with talking(once, identity=certificates.server(days=2), version=version) as (server, plc):
        assert plc.read_holding_registers(1, 1) == [1]
        until(lambda: server.ended)
        now = time.time()
        monkeypatch.setattr(time, "time", lambda: now + 3 * 86_400)
        with pytest.raises(ModbusConnectionError, match="certificate has expired: 'CN=Test"):
            plc.read_holding_registers(1, 1)
        monkeypatch.undo()


def test_the_server_recognizes_returning_clients(connect: Connect, pki: Pki) -> None:
    roles: list[str | None] = []
    device = Device(
        Mapping(holding_registers=10), before_write=lambda access: roles.append(access.role)
    )
    server = Server(device, security=pki.server())
    with (
        server.background("tls://127.0.0.1:0") as running,
        Relay(int(running.urls[0].rpartition(":")[2])) as relay,
        connect(relay.url, security=pki.client(), timeout=LONG) as plc,
    ):
        for number in range(3):
            plc.write_register(0, number)
            relay.cut()
            until(lambda: not server.statistics.connections)
    assert roles == ["Operator"] * 3
    assert (server.statistics.handshakes, server.statistics.handshakes_resumed) == (3, 2)


def unverified(pki: Pki) -> ssl.SSLContext:
    context_ = ssl.create_default_context()
    context_.check_hostname = False
    context_.verify_mode = ssl.CERT_NONE
    return context_


def test_one_ssl_context_serves_several_connections(pki: Pki, connect: Connect) -> None:
    security = GivenContext(context(pki, certificates.client()))
    device = Device(Mapping(holding_registers={7: [5579]}))
    with Server(device, security=pki.server()).background("tls://127.0.0.1:0") as running:
        for _ in range(2):
            with connect(running.urls[0], security=security) as plc:
                assert plc.read_holding_registers(7, 1) == [5579]


def test_an_ssl_context_may_trust_all_certificates(pki: Pki, connect: Connect) -> None:
    stranger = context_of(pki, certificates.self_signed(), verify_mode=ssl.CERT_NONE)
    with (
        TlsServer(stranger) as server,
        connect(server.url, security=GivenContext(unverified(pki))) as plc,
    ):
        assert plc.read_holding_registers(7, 1) == [7]


def test_refusals_of_a_context_are_named(pki: Pki, connect: Connect) -> None:
    bad = context_of(pki, certificates.server(**expired()), verify_mode=ssl.CERT_NONE)
    with (
        TlsServer(bad) as server,
        pytest.raises(ModbusConnectionError, match=r"cannot trust .*expired: 'CN=") as caught,
        connect(server.url, security=GivenContext(context(pki))) as plc,
    ):
        plc.read_holding_registers(7, 1)
    assert "\n" not in str(caught.value)


def test_a_refusal_with_an_ssl_context_names_no_certificate(pki: Pki, connect: Connect) -> None:
    """An SSLContext does not name its certificate."""
    security = GivenContext(context(pki))
    with (
        Server(Device(Mapping()), security=pki.server()).background("tls://127.0.0.1:0") as at,
        pytest.raises(ModbusConnectionError, match="certificate") as caught,
        connect(at.urls[0], security=security) as plc,
    ):
        plc.read_holding_registers(7, 1)
    assert "SHA-256" not in str(caught.value)


WRONG: dict[str, tuple[Any, type[Exception]]] = {
    "none": (None, TypeError),
    "a path": ("own.pem", TypeError),
    "a server's": (ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER), ValueError),
}


@pytest.mark.parametrize(("context_", "error"), WRONG.values(), ids=WRONG)
def test_an_ssl_context_must_be_for_clients(context_: Any, error: type[Exception]) -> None:
    with pytest.raises(error, match="context must be"):
        GivenContext(context_)


def test_a_server_accepts_no_ssl_context(pki: Pki) -> None:
    with pytest.raises(TypeError, match="security"):
        Server(Device(Mapping()), security=GivenContext(context(pki)))  # type: ignore[arg-type]
