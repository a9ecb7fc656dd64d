"""Certificates that expire, are revoked or renewed while connections are open."""

import asyncio
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from libmodbus_py import (
    Client,
    Device,
    Gateway,
    Limits,
    Mapping,
    ModbusConnectionError,
    Route,
    Server,
)
from libmodbus_py.ports import tls
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.security import files
from libmodbus_py.server.limits import ServerStatistics
from libmodbus_py.server.tls import Handshakes
from tests.simulation.network import Network
from tests.support import certificates
from tests.support.certificates import Pki
from tests.support.clients import Connect
from tests.support.peers import until
from tests.support.tls import serving

QUICK = Limits(certificate_interval=0.01)

# The certificate of `Pki.client`.
OPERATOR = partial(certificates.client, "Operator")


@pytest.fixture
def crl(tmp_path: Path) -> Path:
    """A revocation list without entries."""
    file = tmp_path / "crl.pem"
    file.write_bytes(certificates.revocation_list())
    return file


@contextmanager
def gateway(pki: Pki, **options: Any) -> Iterator[tuple[Gateway, int]]:
    device = Device(Mapping(holding_registers=10))
    with Server(device).background("tcp://127.0.0.1:0") as behind:
        gateway = Gateway([Route(behind.urls[0])], **options)
        with gateway.background("tls://127.0.0.1:0") as running:
            yield gateway, parse(running.urls[0]).port


@pytest.mark.parametrize("served", [serving, gateway])
def test_a_client_whose_certificate_is_revoked_is_closed(pki: Pki, crl: Path, served) -> None:
    security = pki.server(crl=crl)
    with (
        served(pki, security=security, limits=QUICK) as (server, port),
        Client(f"tls://127.0.0.1:{port}", security=pki.client()) as thief,
        Client(f"tls://127.0.0.1:{port}", security=pki.client("Viewer")) as other,
    ):
        assert thief.read_holding_registers(0, 1) == other.read_holding_registers(0, 1) == [0]
        crl.write_bytes(certificates.revocation_list(OPERATOR()))
        security.reload()
        until(lambda: server.statistics.closed_untrusted == 1)
        with pytest.raises(ModbusConnectionError):
            thief.read_holding_registers(0, 1)
        assert other.read_holding_registers(0, 1) == [0]
        assert server.statistics.closed_untrusted == 1


def test_a_client_whose_certificate_has_expired_is_closed(pki: Pki, monkeypatch) -> None:
    with (
        serving(pki, limits=QUICK) as (server, port),
        Client(f"tls://127.0.0.1:{port}", security=pki.client()) as plc,
    ):
        plc.read_holding_registers(0, 1)
        end = certificates.end(OPERATOR().certificate).timestamp()
        monkeypatch.setattr(files, "time", SimpleNamespace(time=lambda: end + 1))
        until(lambda: server.statistics.closed_untrusted == 1)


def test_a_client_whose_pin_was_removed_is_closed(pki: Pki, tmp_path: Path) -> None:
    pin = tmp_path / "pin.pem"
    pin.write_bytes(OPERATOR().pem)
    security = pki.server(pin=pin)
    with (
        serving(pki, security=security, limits=QUICK) as (server, port),
        Client(f"tls://127.0.0.1:{port}", security=pki.client()) as plc,
    ):
        plc.read_holding_registers(0, 1)
        security.reload()
        assert plc.read_holding_registers(0, 1) == [0]
        pin.write_bytes(certificates.client("Viewer").pem)
        security.reload()
        until(lambda: server.statistics.closed_untrusted == 1)


def test_other_certificates_can_be_set_while_the_server_runs(pki: Pki) -> None:
    """Who is trusted by both stays; who signed the others does not matter."""
    with (
        serving(pki, limits=QUICK) as (server, port),
        Client(f"tls://127.0.0.1:{port}", security=pki.client()) as plc,
    ):
        plc.read_holding_registers(0, 1)
        with pytest.raises(TypeError, match="security must be Security, not str"):
            server.security = "own.pem"  # type: ignore[assignment]
        bad = pki.security(certificates.server(), pin="ab" * 32)
        with pytest.raises(ValueError, match="a server needs the certificate"):
            server.security = bad
        assert plc.read_holding_registers(0, 1) == [0]
        foreign = pki.authority(certificates.foreign_authority())
        server.security = pki.server(trust=foreign)
        until(lambda: server.statistics.closed_untrusted == 1)
        with pytest.raises(ModbusConnectionError):
            plc.read_holding_registers(0, 1)


def test_a_client_leaves_a_server_whose_certificate_is_revoked(
    pki: Pki, crl: Path, connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tls, "CERTIFICATE_INTERVAL", 0.0)
    security = pki.client(crl=crl)
    with (
        serving(pki, limits=QUICK) as (_, port),
        connect(f"tls://127.0.0.1:{port}", security=security) as plc,
    ):
        assert plc.read_holding_registers(0, 1) == [0]
        crl.write_bytes(certificates.revocation_list(certificates.server()))
        assert plc.read_holding_registers(0, 1) == [0]
        security.reload()
        with pytest.raises(ModbusConnectionError, match="certificate revoked"):
            plc.read_holding_registers(0, 1)


def test_a_client_leaves_a_server_whose_certificate_has_expired(
    pki: Pki, connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next handshake would be refused by OpenSSL, whose clock this test leaves alone."""
    monkeypatch.setattr(tls, "CERTIFICATE_INTERVAL", 0.0)
    with (
        serving(pki) as (server, port),
        connect(f"tls://127.0.0.1:{port}", security=pki.client()) as plc,
    ):
        assert plc.read_holding_registers(0, 1) == [0]
        later = iter([time.time() + 366 * 86_400])
        now = SimpleNamespace(time=lambda: next(later, time.time()))
        monkeypatch.setattr(files, "time", now)
        plc.read_holding_registers(0, 1)
        assert server.statistics.accepted == 2


PLACE = "tls://10.0.0.1:802"
INTERVAL = 10.0


def test_a_closed_endpoint_checks_no_certificates(pki: Pki) -> None:
    statistics = ServerStatistics()

    async def main() -> None:
        limits = Limits(certificate_interval=INTERVAL)
        handshakes = Handshakes(pki.server(), limits, statistics)
        handshakes.open(PLACE)
        for _ in range(3):
            assert statistics.certificate_ends.pop(PLACE) > 0
            await asyncio.sleep(INTERVAL - 0.5)
            assert statistics.certificate_ends == {}
            await asyncio.sleep(0.5 + 0.001)
        assert PLACE in statistics.certificate_ends
        for _ in range(2):
            handshakes.close()
            assert statistics.certificate_ends == {}
            await asyncio.sleep(5 * INTERVAL)
            assert statistics.certificate_ends == {}

    Network().run(main)
