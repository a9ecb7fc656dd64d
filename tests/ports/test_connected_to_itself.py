"""
A dead port of this machine: where the system chooses that very port for a client, the client is
connected to itself (RFC 9293, 3.5: both ends open at once), which is not a connection.

That the system chooses it is one chance in thousands, so the clients bind it here before they
connect; the rest is the system's own.
"""

from __future__ import annotations

import errno
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Context, Gateway, ModbusConnectionError, ModbusError, Route
from libmodbus_py.listen import listen
from tests.support import certificates
from tests.support.certificates import Papers
from tests.support.clients import ALL, asking

SCHEMES = ["tcp", "rtu+tcp", "ascii+tcp", "udp", "rtu+udp", "tls"]


@pytest.fixture
def dead_port(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A port of this machine where nothing listens, and from which every connection to it comes."""
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        port: int = bound.getsockname()[1]
    connect, connect_ex = socket.socket.connect, socket.socket.connect_ex

    def of_itself(method: Any) -> Any:
        def connected(made: socket.socket, address: Any) -> Any:
            if address[1] == port:
                made.bind(address)
            return method(made, address)

        return connected

    monkeypatch.setattr(socket.socket, "connect", of_itself(connect))
    monkeypatch.setattr(socket.socket, "connect_ex", of_itself(connect_ex))
    yield port
    monkeypatch.undo()
    with socket.socket() as bound:  # it was left as it was found: nothing waits in the system
        bound.bind(("127.0.0.1", port))


def test_such_a_port_can_be_connected_to_itself(dead_port: int) -> None:
    """The system does it: without this the other tests here would show nothing."""
    with socket.socket() as made:
        made.connect(("127.0.0.1", dead_port))
        assert made.getsockname() == made.getpeername()
        made.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, bytes([1, 0, 0, 0, 0, 0, 0, 0]))


@ALL
@pytest.mark.parametrize("scheme", SCHEMES)
def test_clients(kind: str, scheme: str, dead_port: int, tmp_path: Path) -> None:
    options: dict[str, Any] = {}
    if scheme == "tls":
        options["security"] = Papers(tmp_path).security(certificates.client())
    url = f"{scheme}://127.0.0.1:{dead_port}"
    with (
        pytest.raises(ModbusConnectionError, match="Connection refused") as caught,
        asking(kind, url, **options) as client,
    ):
        client.read_coils(0, 1)
    assert caught.value.errno == errno.ECONNREFUSED


@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp", "udp"])
def test_the_line_of_a_gateway(
    scheme: str, dead_port: int, caplog: pytest.LogCaptureFixture
) -> None:
    gateway = Gateway([Route(f"{scheme}://127.0.0.1:{dead_port}")])
    with (
        gateway.background("tcp://127.0.0.1:0") as running,
        Context.from_url(running.urls[0]) as client,
        pytest.raises(ModbusError),
    ):
        client.read_coils(0, 1)
    assert "Connection refused" in caplog.text


def test_the_links_of_a_tap(dead_port: int, caplog: pytest.LogCaptureFixture) -> None:
    line = listen("rtu+tcp://127.0.0.1:0", between=f"rtu+tcp://127.0.0.1:{dead_port}")
    port = int(line.url.rpartition(":")[2])
    with line, socket.create_connection(("127.0.0.1", port)) as client:
        client.shutdown(socket.SHUT_WR)
        assert client.recv(100) == b""
    assert "Connection refused" in caplog.text
