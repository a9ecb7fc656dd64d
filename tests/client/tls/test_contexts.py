"""
Clients with a TLS context that the program brings.
"""

import ssl
from typing import Any

import pytest

from libmodbus_py import Device, Mapping, ModbusConnectionError, Server
from libmodbus_py.security.security import GivenContext
from tests.support import certificates
from tests.support.certificates import Papers, expired
from tests.support.clients import Connect
from tests.support.secured import context_of
from tests.support.tls import context
from tests.support.tls_peers import TlsServer


def unverified(papers: Papers) -> ssl.SSLContext:
    made = ssl.create_default_context()
    made.check_hostname = False
    made.verify_mode = ssl.CERT_NONE
    return made


def test_a_given_context_serves_several_connections(papers: Papers, connect: Connect) -> None:
    given = GivenContext(context(papers, certificates.client()))
    device = Device(Mapping(holding_registers={7: [5579]}))
    with Server(device, security=papers.server()).background("tls://127.0.0.1:0") as running:
        for _ in range(2):
            with connect(running.urls[0], security=given) as plc:
                assert plc.read_holding_registers(7, 1) == [5579]


def test_a_given_context_may_trust_everybody(papers: Papers, connect: Connect) -> None:
    stranger = context_of(papers, certificates.self_signed(), verify_mode=ssl.CERT_NONE)
    with (
        TlsServer(stranger) as server,
        connect(server.url, security=GivenContext(unverified(papers))) as plc,
    ):
        assert plc.read_holding_registers(7, 1) == [7]


def test_what_a_given_context_refuses_is_named(papers: Papers, connect: Connect) -> None:
    bad = context_of(papers, certificates.server(**expired()), verify_mode=ssl.CERT_NONE)
    with (
        TlsServer(bad) as server,
        pytest.raises(ModbusConnectionError, match=r"cannot trust .*expired: 'CN=") as caught,
        connect(server.url, security=GivenContext(context(papers))) as plc,
    ):
        plc.read_holding_registers(7, 1)
    assert "\n" not in str(caught.value)


def test_a_refusal_of_ours_names_no_certificate(papers: Papers, connect: Connect) -> None:
    """No context says which one it shows."""
    given = GivenContext(context(papers))
    with (
        Server(Device(Mapping()), security=papers.server()).background("tls://127.0.0.1:0") as at,
        pytest.raises(ModbusConnectionError, match="certificate") as caught,
        connect(at.urls[0], security=given) as plc,
    ):
        plc.read_holding_registers(7, 1)
    assert "SHA-256" not in str(caught.value)


WRONG: dict[str, tuple[Any, type[Exception]]] = {
    "none": (None, TypeError),
    "a path": ("own.pem", TypeError),
    "a server's": (ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER), ValueError),
}


@pytest.mark.parametrize(("given", "error"), WRONG.values(), ids=WRONG)
def test_a_context_must_be_a_clients(given: Any, error: type[Exception]) -> None:
    with pytest.raises(error, match="context must be"):
        GivenContext(given)


def test_a_server_takes_security_only(papers: Papers) -> None:
    with pytest.raises(TypeError, match="security"):
        Server(Device(Mapping()), security=GivenContext(context(papers)))  # type: ignore[arg-type]
