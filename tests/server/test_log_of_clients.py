"""
What the log says of clients that limits, networks, roles, routes and TLS refuse: a line at once,
and then a line a minute with their number.
"""

import contextlib
import logging
import re
import ssl
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Device, Gateway, Limits, Mapping, Route, Server
from libmodbus_py.serve import Allow, Rules
from tests.simulation.lan import Lan
from tests.support import certificates
from tests.support.attacks import READ_ONE, adu
from tests.support.certificates import Pki
from tests.support.tls import TlsClient, context

TABLE = (Path(__file__).parents[2] / "docs" / "log.md").read_text()

WRITE_ONE = bytes.fromhex("06 0000 0001")

TIMES = 4


@contextmanager
def asking(lan: Lan, server: Server | Gateway, data: bytes = b"") -> Iterator[None]:
    """Serve while so many clients send some bytes, and stay."""
    with server.background("tcp://10.0.0.1:0") as running:
        for _ in range(TIMES):
            client = lan.client(running.urls[0])
            with contextlib.suppress(OSError):
                client.sendall(data)
            lan.pass_time(1)
        yield


def limited(data: bytes = b"", **limits: Any) -> Callable[..., AbstractContextManager[None]]:
    def cause(lan: Lan, pki: Pki) -> AbstractContextManager[None]:
        device = Device(Mapping(holding_registers=10))
        return asking(lan, Server(device, limits=Limits(**limits)), data)

    return cause


def without_a_right(lan: Lan, pki: Pki) -> AbstractContextManager[None]:
    device = Device(Mapping(holding_registers=10), authorize=Rules({None: Allow(read="all")}))
    return asking(lan, Server(device), adu(WRITE_ONE))


def on_a_read_only_route(lan: Lan, pki: Pki) -> AbstractContextManager[None]:
    lan.line("/dev/line")
    return asking(lan, Gateway([Route("rtu:///dev/line", read_only=True)]), adu(WRITE_ONE))


@contextmanager
def greeting(lan: Lan, pki: Pki, **options: Any) -> Iterator[int]:
    server = Server(Device(Mapping(10)), security=pki.server(**options))
    with server.background("tls://127.0.0.1:0") as running:
        yield int(running.urls[0].rpartition(":")[2])


def presenting(
    identity: Callable[[], Any], *revoked: Any
) -> Callable[..., AbstractContextManager[None]]:
    @contextmanager
    def cause(lan: Lan, pki: Pki) -> Iterator[None]:
        options = {}
        if revoked:
            path = pki.files(certificates.server()).cert.with_name("crl.pem")
            path.write_bytes(certificates.revocation_list(*(serial() for serial in revoked)))
            options["crl"] = path
        with greeting(lan, pki, **options) as port:
            for _ in range(TIMES):
                context_ = context(pki, identity(), ssl.TLSVersion.TLSv1_2)
                with TlsClient(port, context_, lan=lan) as client, pytest.raises(ssl.SSLError):
                    client.handshake()
            yield

    return cause


@contextmanager
def without_a_handshake(lan: Lan, pki: Pki) -> Iterator[None]:
    with greeting(lan, pki) as port:
        clients = [lan.client(port) for _ in range(TIMES)]
        lan.pass_time(6)
        assert all(client.is_closed() for client in clients)
        yield


TROUBLES: dict[str, tuple[Callable[..., AbstractContextManager[Any]], str]] = {
    "a slow frame": (limited(b"\0\1\0\0", frame_timeout=0.5), "(frame_timeout)"),
    "a flood": (limited(adu(READ_ONE) * 100, requests_per_second=20), "(requests_per_second)"),
    "too many, the new one": (
        limited(max_connections=1, when_full="refuse", connections_per_address=9),
        "1 connections are open (max_connections)",
    ),
    "too many, the idle one": (limited(max_connections=1), "another connection (max_connections)"),
    "too many of an address": (
        limited(connections_per_address=1, when_full="refuse"),
        "has 1 connections (connections_per_address)",
    ),
    "no Modbus": (limited(b"GET / HTTP/1.1\r\n\r\n"), "connection closed: header with"),
    "another network": (limited(allow=["192.0.2.0/24"]), "refused: not in an allowed network"),
    "a wrong role": (
        without_a_right,
        "without a role, may not use function 6 of unit 17, write holding_registers 0..0",
    ),
    "a read-only route": (
        on_a_read_only_route,
        "forwards no function 6 of unit 17, write holding_registers 0..0 (read_only, writable)",
    ),
    "no handshake": (without_a_handshake, "no TLS handshake within 5 s (handshake_timeout)"),
    "no certificate": (presenting(lambda: None), "did not return a certificate"),
    "an expired one": (
        presenting(lambda: certificates.client(**certificates.expired())),
        "certificate has expired: 'CN=",
    ),
    "a revoked one": (
        presenting(certificates.client, certificates.client),
        "certificate revoked: 'CN=",
    ),
    "a foreign one": (
        presenting(lambda: certificates.client(issuer=certificates.foreign_authority())),
        "TLS refused: ",
    ),
}


@pytest.mark.parametrize("trouble", TROUBLES)
def test_each_refusal_is_logged_at_once_and_then_once_a_minute(lan: Lan, pki: Pki, trouble, caplog):
    cause, text = TROUBLES[trouble]
    with ExitStack() as stack, caplog.at_level(logging.WARNING):
        stack.enter_context(cause(lan, pki))
        (line,) = caplog.messages
        lan.pass_time(61)
        lan.pass_time(600)
    assert re.match(r"(10|127)\.[\d.]+:\d+[:,] ", line)
    assert text in line
    lines = caplog.messages[1:]
    assert all("since the last line like this" in line for line in lines)
    assert len(lines) == 1
    rows = re.findall(r"^`(.+?)` \| (?!\*)", TABLE, re.MULTILINE)
    assert any(re.fullmatch(re.escape(row).replace("…", ".*"), line) for row in rows)
