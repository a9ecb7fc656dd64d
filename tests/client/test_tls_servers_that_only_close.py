"""
Servers that refuse our certificate without an alert: what the error says.
"""

from __future__ import annotations

import socket
import ssl
from functools import partial
from pathlib import Path

import pytest

from libmodbus_py import ModbusConnectionError
from tests.support import certificates
from tests.support.certificates import Papers, foreign_authority
from tests.support.clients import Connect
from tests.support.tls_peers import raw

HINT = "it may have refused our certificate"


def closing_behind(flights: int, context: ssl.SSLContext, sock: socket.socket) -> None:
    """Take so many flights of a client, answer those before the last, and close."""
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    tls = context.wrap_bio(incoming, outgoing, server_side=True)
    for flight in range(flights):
        incoming.write(sock.recv(65_536))
        if flight == flights - 1:
            return
        with pytest.raises(ssl.SSLWantReadError):
            tls.do_handshake()
        sock.sendall(outgoing.read())


@pytest.mark.parametrize(("flights", "is_suspected"), [(1, False), (2, True)])
def test_a_tls_1_2_server_that_closes_behind_our_certificate(
    connect: Connect, tmp_path: Path, flights: int, is_suspected: bool
) -> None:
    papers = Papers(tmp_path)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.maximum_version = ssl.TLSVersion.TLSv1_2
    files = papers.files(certificates.server())
    context.load_cert_chain(files.cert, files.key)
    context.load_verify_locations(papers.ca)
    context.verify_mode = ssl.CERT_REQUIRED
    own = papers.security(certificates.client(issuer=foreign_authority()))
    with (
        raw(partial(closing_behind, flights, context)) as url,
        pytest.raises(ModbusConnectionError, match="no TLS handshake") as caught,
        connect(url, security=own, timeout=30) as plc,
    ):
        plc.read_holding_registers(0, 1)
    assert (HINT in str(caught.value)) is is_suspected
