"""
A client without TLS at a server of TLS, and the other way round: both clients say so.
"""

from __future__ import annotations

import pytest

from libmodbus_py import ModbusConnectionError, ModbusError
from libmodbus_py.client.hints import explain, explain_end
from tests.support.cases import each_case
from tests.support.clients import ALL, asking
from tests.support.peers import FakeServer

ALERT = bytes.fromhex("15 0303 0002 0246")  # RFC 8446, 5.1 and 6: protocol_version, fatal


@each_case(
    ("scheme", "received", "hint"),
    [
        *((scheme, ALERT.hex(), "this looks like tls://") for scheme in ("tcp", "rtu+tcp")),
        ("ascii+tcp", "16 0301 0040 01", "this looks like tls://"),
        ("udp", ALERT.hex(), ""),
        ("tcp", "15 0303", ""),
        ("tcp", "15 0400 0002", ""),
    ],
)
def test_records_of_tls_are_recognised(scheme: str, received: str, hint: str) -> None:
    assert explain(scheme, bytes(12), bytes.fromhex(received)) == hint


@each_case(
    ("scheme", "number", "is_likely"),
    [("tcp", 104, True), ("rtu+tcp", 32, True), ("tcp", 110, False), ("tls", 104, False)],
)
def test_ends_before_any_answer(scheme: str, number: int, is_likely: bool) -> None:
    assert bool(explain_end(scheme, number)) == is_likely


@ALL
def test_an_alert_is_named(kind: str) -> None:
    with FakeServer(lambda _: [ALERT]) as server:
        url = f"tcp://127.0.0.1:{server.port}"
        with asking(kind, url, timeout=5) as plc, pytest.raises(ModbusError, match="like tls://"):
            plc.read_coils(0, 1)


@ALL
def test_a_server_that_closes_at_the_first_request(kind: str) -> None:
    with FakeServer(None) as server:
        url = f"tcp://127.0.0.1:{server.port}"
        with (
            asking(kind, url, timeout=5) as plc,
            pytest.raises(ModbusConnectionError, match=r"nothing was answered yet; .* tls://"),
        ):
            plc.read_coils(0, 1)
