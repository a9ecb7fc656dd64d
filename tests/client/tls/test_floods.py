"""Servers of TLS that send without end, or nonsense, or do not read."""

import contextlib
import random
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Client, ModbusError, State, pdu
from libmodbus_py.ports.tls import TlsPort
from tests.support.certificates import Pki
from tests.support.clients import Connect
from tests.support.peers import echo, mbap, until
from tests.support.reads import reads
from tests.support.tls_clients import LONG, SOON, Serving, Talking, descriptors
from tests.support.tls_peers import HANDSHAKE, Peer, Relay, Sealed, TlsServer

# Bytes of a flood up to the end of a request: those read, and those in the system.
MUCH = 30_000_000


FULL = 1 << 18
"""Bytes after which the system holds as many as it takes for a client that does not read."""


FLOODS: dict[str, Callable[[Sealed], bytes]] = {
    "records": lambda sealed: sealed.record(b"\0\1\0\0\0\5\1\3\2\0\0" * 1000),
    "tickets": lambda sealed: sealed.record(sealed.ticket(1000), HANDSHAKE),
    "changes of keys": lambda sealed: sealed.change_of_keys(),
    "changes of keys that want answers": lambda sealed: sealed.change_of_keys(
        is_answer_wanted=True
    ),
    "empty records": lambda sealed: sealed.record(b""),
    "one byte in padding": lambda sealed: sealed.record(b"\0" + b"\x17" + bytes(16_000), 0),
}


@contextlib.contextmanager
def flooding(
    serving: Serving, tmp_path: Path, kind: str, is_asked: bool
) -> Iterator[tuple[TlsServer, list[int]]]:
    """A server that floods after the first answer, or with the second request; and how much."""
    log, sizes = tmp_path / "keys", [0]

    def script(peer: Peer) -> None:
        sealed = Sealed(log, count=peer.tls.context.num_tickets)
        peer.sock.sendall(sealed.record(echo(peer.request())))
        if is_asked:
            peer.request()
        peer.sock.settimeout(SOON)
        with contextlib.suppress(OSError):
            while sizes[0] < 100_000_000:
                data = b"".join(FLOODS[kind](sealed) for _ in range(20))
                peer.sock.sendall(data)
                sizes[0] += len(data)

    with serving(script, version="1.3", keylog_filename=str(log)) as server:
        yield server, sizes


@pytest.mark.parametrize("kind", FLOODS)
def test_a_flood_while_a_request_waits_ends_with_the_timeout(
    connect: Connect, pki: Pki, serving: Serving, tmp_path: Path, kind: str
) -> None:
    with (
        flooding(serving, tmp_path, kind, is_asked=True) as (server, sizes),
        connect(server.url, security=pki.client(), timeout=1) as plc,
    ):
        assert plc.read_holding_registers(1, 1) == [1]
        with pytest.raises(ModbusError):
            plc.read_holding_registers(2, 1)
        server.script = Peer.serve
    assert kind == "records" or sizes[0] < MUCH


@pytest.mark.parametrize("kind", FLOODS)
def test_a_flood_without_requests_is_bounded(
    connect: Connect, pki: Pki, serving: Serving, tmp_path: Path, kind: str
) -> None:
    with (
        flooding(serving, tmp_path, kind, is_asked=False) as (server, sizes),
        connect(server.url, security=pki.client(), timeout=LONG, max_pause=0) as plc,
    ):
        assert plc.read_holding_registers(1, 1) == [1]
        if not isinstance(plc, Client):
            until(lambda: plc.state is State.DISCONNECTED)
        else:
            until(lambda: sizes[0] > FULL)
        server.script = Peer.serve
        for number in range(3):
            assert plc.read_holding_registers(number, 1) == [number]
    assert sizes[0] < MUCH


@pytest.fixture
def small_buffers(monkeypatch: pytest.MonkeyPatch) -> None:
    """The system accepts what is sent in parts only."""
    preparing = TlsPort._preparing

    def prepare(port: TlsPort, sock: socket.socket, deadline: float) -> Any:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        yield from preparing(port, sock, deadline)

    monkeypatch.setattr(TlsPort, "_preparing", prepare)


@pytest.mark.usefixtures("small_buffers")
def test_requests_are_sent_complete_and_in_order(talking: Talking) -> None:
    """To a server that reads late and little by little."""
    count, frames = 300, []

    def script(peer: Peer) -> None:
        peer.sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        time.sleep(0.1)
        while request := peer.request():
            frames.append(request)
            peer.write(mbap(request, request[7:12]))

    with talking(script, client={"timeout": 60, "max_in_flight": 256}) as (_, plc):
        requests = [pdu.WriteRegisters(number, (number,) * 120) for number in range(count)]
        assert plc.execute_many(requests) == [None] * count
        assert plc.statistics.connects == 1
    assert [int.from_bytes(frame[8:10], "big") for frame in frames] == list(range(count))
    for frame in frames:
        assert frame[13:] == frame[8:10] * 120


@pytest.mark.usefixtures("small_buffers")
def test_a_request_after_much_unsent_data_is_sent(talking: Talking, tmp_path: Path) -> None:
    """The answers to changes of keys, which the server does not read for a while."""
    log, is_full = tmp_path / "keys", threading.Event()

    def script(peer: Peer) -> None:
        sealed = Sealed(log, count=peer.tls.context.num_tickets)
        peer.sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        peer.sock.sendall(sealed.record(echo(peer.request())))
        changes = [sealed.change_of_keys(is_answer_wanted=True) for _ in range(1000)]
        peer.sock.sendall(b"".join(changes))
        is_full.set()
        time.sleep(0.2)
        while request := peer.request():
            peer.sock.sendall(sealed.record(echo(request)))

    with talking(script, version="1.3", keylog_filename=str(log)) as (_, plc):
        assert plc.read_holding_registers(1, 1) == [1]
        assert is_full.wait(LONG)
        assert plc.read_holding_registers(2, 1) == [2]
        assert plc.statistics.connects == 1


@pytest.mark.parametrize("seed", range(4))
def test_invalid_records_of_the_server_are_modbus_errors(
    connect: Connect, pki: Pki, serving: Serving, seed: int
) -> None:
    """One byte that it sends, in the handshake or after it, is changed, lost, doubled or added."""
    chance = random.Random(seed)
    where, how, position = 0, 0, 0

    def alter(data: bytes) -> list[bytes]:
        nonlocal position
        at, position = where - position, position + len(data)
        if not 0 <= at < len(data):
            return [data]
        piece = [
            bytes([data[at] ^ 1 << chance.randrange(8)]),
            b"",
            data[at : at + 1] * 2,
            chance.randbytes(chance.randrange(1, 400)),
        ][how]
        return [data[:at] + piece + data[at + 1 :]]

    before = descriptors()
    version = "1.2" if seed % 2 else "1.3"
    failures = 0
    with serving(version=version) as server, Relay(server.port, alter) as relay:
        security = pki.client()
        for _ in range(25):
            where, how, position = int(1.01 ** chance.randrange(760)), chance.randrange(4), 0
            plc = connect(relay.url, security=security, timeout=0.15)
            try:
                for number in range(3):
                    assert plc.read_holding_registers(number, 1) == [number]
                assert plc.execute_many(reads(20)) == [[number] for number in range(20)]
            except ModbusError:
                failures += 1
            plc.close()
            relay.cut()
    assert failures
    until(lambda: descriptors() <= before + 2)
