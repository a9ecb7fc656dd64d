"""
Time, life and floods of TLS connections, at the client's end.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import (
    AsyncClient,
    Context,
    Device,
    Mapping,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    Server,
    State,
    pdu,
)
from libmodbus_py.ports.tls import TlsPort
from tests.support import certificates
from tests.support.certificates import Papers, secured
from tests.support.clients import Connect, connecting
from tests.support.peers import dead, echo, mbap, until
from tests.support.scripted import run as run_in_loop
from tests.support.tls_peers import (
    HANDSHAKE,
    Peer,
    Relay,
    Script,
    Sealed,
    TlsServer,
    context_of,
    raw,
)

LONG = 20.0

ALERT, ACCESS_DENIED = 21, b"\x02\x31"

# Of what must come at once, on a machine that is busy.
SOON = 10.0


@pytest.fixture(params=["python", "asyncio"])
def connect(request: pytest.FixtureRequest) -> Iterator[Connect]:
    """Makes clients of both kinds; C carries nothing over TLS."""
    with connecting(request.param) as made:
        yield made


Serving = Callable[..., TlsServer]


@pytest.fixture
def serving(papers: Papers) -> Serving:
    """Makes a server; options of `context_of`."""

    def make(script: Script = Peer.serve, version: str | None = None, **options: Any) -> TlsServer:
        return TlsServer(context_of(papers, certificates.server(), version, **options), script)

    return make


def reads(count: int) -> list[pdu.ReadHoldingRegisters]:
    return [pdu.ReadHoldingRegisters(address, 1) for address in range(count)]


def trickles(sock: socket.socket) -> None:
    """A ServerHello without an end, byte by byte."""
    sock.recv(4096)
    for each in b"\x16\x03\x03\x40\x00\x02\x00\x3f\xfc\x03\x03" + bytes(16_000):
        sock.sendall(bytes([each]))
        time.sleep(0.02)


def says_hello_again_and_again(sock: socket.socket) -> None:
    """HelloRequest, which every client ignores while it shakes hands (RFC 5246, 7.4.1.1)."""
    sock.recv(4096)
    while True:
        sock.sendall(b"\x16\x03\x03\0\x04\0\0\0\0" * 1000)


def stalls(sock: socket.socket) -> None:
    while sock.recv(4096):
        pass


@pytest.mark.parametrize("talk", [trickles, says_hello_again_and_again, stalls])
def test_a_handshake_ends_with_the_timeout(
    connect: Connect, papers: Papers, talk: Callable[[socket.socket], object]
) -> None:
    with raw(talk) as url:
        plc = connect(url, security=papers.client(), timeout=0.2)
        begin = time.monotonic()
        with pytest.raises(ModbusConnectionError) as caught:
            plc.read_holding_registers(0, 1)
        assert time.monotonic() - begin >= 0.19
        assert caught.value.errno is not None
        assert os.strerror(caught.value.errno) == "Connection timed out"
        plc.close()


def test_a_handshake_that_stops_after_the_servers_hello(
    connect: Connect, papers: Papers, serving: Serving
) -> None:
    seen = 0

    def first_hundred(data: bytes) -> list[bytes]:
        nonlocal seen
        seen += len(data)
        return [data[: max(0, 100 - seen + len(data))]]

    with serving() as server, Relay(server.port, first_hundred) as relay:
        plc = connect(relay.url, security=papers.client(), timeout=0.5)
        with pytest.raises(ModbusConnectionError):
            plc.read_holding_registers(0, 1)
        plc.close()
    assert seen > 100


def test_a_dead_host(connect: Connect, papers: Papers) -> None:
    with dead() as port:
        plc = connect(f"tls://127.0.0.1:{port}", security=papers.client(), timeout=0.1)
        with pytest.raises(ModbusConnectionError):
            plc.read_holding_registers(0, 1)
        plc.close()


def test_a_slow_handshake_is_good_if_there_is_time(
    connect: Connect, papers: Papers, serving: Serving
) -> None:
    def bytewise(data: bytes) -> Iterator[bytes]:
        for at in range(0, len(data), 7):
            time.sleep(0.0002)
            yield data[at : at + 7]

    with (
        serving() as server,
        Relay(server.port, bytewise) as relay,
        connect(relay.url, security=papers.client(), timeout=LONG) as plc,
    ):
        assert plc.read_holding_registers(5, 1) == [5]


# --- closing, cancelling, forking -----------------------------------------------------------


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


def test_close_ends_a_handshake(connect: Connect, papers: Papers) -> None:
    reached = threading.Event()

    def talk(sock: socket.socket) -> None:
        sock.recv(4096)
        reached.set()
        stalls(sock)

    with raw(talk) as url:
        plc = connect(url, security=papers.client(), timeout=60)
        errors: list[Exception] = []

        def ask() -> None:
            try:
                plc.read_holding_registers(0, 1)
            except Exception as error:
                errors.append(error)

        thread = threading.Thread(target=ask)
        thread.start()
        assert reached.wait(SOON)
        plc.close()
        thread.join(SOON)
        assert not thread.is_alive()
        (error,) = errors
        assert isinstance(error, ModbusConnectionError)
        assert "closed" in str(error)


@pytest.mark.parametrize("deed", ["close", "Ctrl-C"])
def test_a_signal_in_the_handshake(papers: Papers, deed: str) -> None:
    with raw(stalls) as url:
        plc = Context.from_url(url, security=papers.client(), timeout=60)
        before = descriptors()

        def handle(*_: object) -> None:
            if deed == "close":
                plc.close()
            else:
                raise KeyboardInterrupt

        old = signal.signal(signal.SIGALRM, handle)
        try:
            signal.setitimer(signal.ITIMER_REAL, 0.3)
            expected = ModbusConnectionError if deed == "close" else KeyboardInterrupt
            with pytest.raises(expected):
                plc.connect()
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, old)
        until(lambda: descriptors() <= before)
        plc.close()


def test_a_client_goes_on_after_ctrl_c_in_the_handshake(papers: Papers, serving: Serving) -> None:
    is_silent = True

    def handle(*_: object) -> None:
        raise KeyboardInterrupt

    old = signal.signal(signal.SIGALRM, handle)
    try:
        with (
            serving() as server,
            Relay(server.port, lambda data: [] if is_silent else [data]) as relay,
            contextlib.closing(
                Context.from_url(relay.url, security=papers.client(), timeout=LONG)
            ) as plc,
        ):
            signal.setitimer(signal.ITIMER_REAL, 0.3)
            with pytest.raises(KeyboardInterrupt):
                plc.connect()
            is_silent = False
            assert plc.read_holding_registers(5, 1) == [5]
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, old)


def test_closing_at_each_await_of_a_handshake(papers: Papers, serving: Serving) -> None:
    """No descriptor is left, no task, and what is opened next in its place is heard."""

    def bytewise(data: bytes) -> Iterator[bytes]:
        for at in range(0, len(data), 40):
            yield data[at : at + 40]

    async def main(url: str) -> set[str]:
        security, outcomes = papers.client(), set()
        loop = asyncio.get_running_loop()
        before = descriptors()
        for turns in [*range(30), *range(30, 300, 9)]:
            plc = AsyncClient(url, security=security, timeout=LONG)
            asking = loop.create_task(plc.connect())
            for _ in range(turns):
                await asyncio.sleep(0)
            if turns % 2:
                asking.cancel()
            await plc.close()
            try:
                await asking
                outcomes.add("connected")
            except ModbusConnectionError:
                outcomes.add("failed")
            except asyncio.CancelledError:
                outcomes.add("cancelled")
            near, far = socket.socketpair()
            heard = asyncio.Event()
            loop.add_reader(near, heard.set)
            far.send(b"x")
            await asyncio.wait_for(heard.wait(), SOON)
            loop.remove_reader(near)
            near.close()
            far.close()
        while descriptors() > before:  # the server has its own of each connection
            await asyncio.sleep(0.01)
        return outcomes

    with raw(lambda sock: _serve(papers, sock, bytewise)) as url:
        outcomes = run_in_loop(asyncio.wait_for(main(url), 60))
        assert {"failed", "cancelled"} <= outcomes


def _serve(papers: Papers, sock: socket.socket, cut: Callable[[bytes], Iterator[bytes]]) -> None:
    peer = Peer(sock, context_of(papers, certificates.server()))
    peer.cut = cut
    peer.shake_hands()
    peer.serve()


def test_a_forked_child_leaves_the_connection_alone(papers: Papers) -> None:
    """It connects anew, and says no goodbye in the parent's name."""
    server = Server(Device(Mapping(holding_registers=10)))
    with secured(server, papers) as url, Context.from_url(url, timeout=LONG) as plc:
        plc.write_register(0, 7)
        child = os.fork()
        if child == 0:
            code = 1
            with contextlib.suppress(BaseException):
                code = 0 if plc.read_holding_registers(0, 1) == [7] else 2
                plc.close()
            os._exit(code)
        assert os.waitpid(child, 0)[1] == 0
        assert plc.read_holding_registers(0, 1) == [7]
        assert plc.statistics.connects == 1
        assert server.statistics.handshakes == 2


def test_an_asyncio_client_that_ends_in_a_child_leaves_the_connection_alone(
    papers: Papers,
) -> None:
    async def main(url: str) -> None:
        async with AsyncClient(url, timeout=LONG) as plc:
            await plc.write_register(0, 7)
            child = os.fork()
            if child == 0:
                plc._driver._port.close()
                os._exit(0)
            os.waitpid(child, 0)
            assert await plc.read_holding_registers(0, 1) == [7]
            assert plc.statistics.connects == 1

    with secured(Server(Device(Mapping(holding_registers=10))), papers) as url:
        run_in_loop(main(url))


# --- ends -----------------------------------------------------------------------------------


def test_a_goodbye_while_a_request_waits(
    connect: Connect, papers: Papers, serving: Serving
) -> None:
    """TLS has ended, though TCP has not."""
    done = threading.Event()

    def script(peer: Peer) -> None:
        peer.request()
        peer.sock.sendall(peer.end())
        done.wait(300)

    with serving(script) as server:
        with (
            connect(server.url, security=papers.client(), timeout=600) as plc,
            pytest.raises(ModbusConnectionError, match="closed by the other side"),
        ):
            plc.read_holding_registers(0, 1)
        done.set()


def test_an_answer_and_a_goodbye_in_one_go(
    connect: Connect, papers: Papers, serving: Serving
) -> None:
    """The answer counts, and who waits for another one hears at once that there is none."""
    done = threading.Event()

    def script(peer: Peer) -> None:
        asked = [peer.request() for _ in range(4)]
        peer.sock.sendall(peer.sealed(echo(asked[0])) + peer.end())
        done.wait(300)

    with serving(script) as server:
        options = {"timeout": 600, "max_in_flight": 16}
        with connect(server.url, security=papers.client(), **options) as plc:
            found = plc.execute_many(reads(4), max_in_flight=8, return_exceptions=True)
            assert found[0] == [0]
            assert [type(each) for each in found[1:]] == [ModbusConnectionError] * 3
            assert "closed by the other side" in str(found[1])
        done.set()


def test_an_answer_and_an_alert_in_one_go(
    connect: Connect, papers: Papers, serving: Serving, tmp_path: Path
) -> None:
    """More requests wait to be sent, and cannot be any more."""
    log = tmp_path / "keys"
    kept: list[socket.socket] = []

    def script(peer: Peer) -> None:
        sealed = Sealed(log, count=peer.tls.context.num_tickets)
        request = peer.request()
        kept.append(peer.sock.dup())
        server.script = Peer.serve
        peer.sock.sendall(sealed.record(echo(request)) + sealed.record(ACCESS_DENIED, ALERT))

    with serving(script, "1.3", keylog_filename=str(log)) as server:
        with connect(server.url, security=papers.client(), timeout=600) as plc:
            found = plc.execute_many(reads(9), max_in_flight=4, return_exceptions=True)
        kept[0].close()
    refused = [each for each in found if isinstance(each, ModbusConnectionError)]
    assert found[0] == [0]
    assert refused
    assert {each.args[0].partition(": ")[0].partition(" ")[2] for each in refused} == {
        "refused our certificate (tlsv1 alert access denied)"
    }
    assert found[-1] == [8]


def test_a_connection_that_ends_within_a_record(
    connect: Connect, papers: Papers, serving: Serving
) -> None:
    def script(peer: Peer) -> None:
        peer.sock.sendall(peer.sealed(echo(peer.request()))[:20])

    with (
        serving(script) as server,
        connect(server.url, security=papers.client(), timeout=LONG) as plc,
    ):
        with pytest.raises(ModbusConnectionError, match="closed by the other side"):
            plc.read_holding_registers(0, 1)
        server.script = Peer.serve
        assert plc.read_holding_registers(4, 1) == [4]


def test_late_answers_are_dropped(connect: Connect, papers: Papers, serving: Serving) -> None:
    def script(peer: Peer) -> None:
        first, second = peer.request(), peer.request()
        peer.write(mbap(first, b"\x03\x02\xff\xff"), echo(second))
        peer.serve()

    with (
        serving(script) as server,
        connect(server.url, security=papers.client(), timeout=LONG) as plc,
    ):
        with pytest.raises(ModbusTimeoutError):
            plc.execute(pdu.ReadHoldingRegisters(1, 1), timeout=0.1)
        assert plc.read_holding_registers(2, 1) == [2]
        assert plc.read_holding_registers(3, 1) == [3]
        assert plc.late_answers == 1
    assert server.connections == 1


def test_retries_go_over_a_new_connection(
    connect: Connect, papers: Papers, serving: Serving
) -> None:
    with (
        serving(Peer.request) as server,
        connect(server.url, security=papers.client(), timeout=LONG, retries=2) as plc,
    ):
        with pytest.raises(ModbusConnectionError):
            plc.read_holding_registers(1, 1)
        assert plc.statistics.retries == 2
        server.script = Peer.serve
        until(lambda: _asked(plc) == [1])
    assert server.connections >= 4


def _asked(plc: Any) -> Any:
    with contextlib.suppress(ModbusConnectionError):
        return plc.read_holding_registers(1, 1)


# --- floods ---------------------------------------------------------------------------------


# Of a flood that a client gives up: what it read, and what the system holds.
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
    log, sent = tmp_path / "keys", [0]

    def script(peer: Peer) -> None:
        sealed = Sealed(log, count=peer.tls.context.num_tickets)
        peer.sock.sendall(sealed.record(echo(peer.request())))
        if is_asked:
            peer.request()
        peer.sock.settimeout(SOON)
        with contextlib.suppress(OSError):
            while sent[0] < 100_000_000:
                data = b"".join(FLOODS[kind](sealed) for _ in range(20))
                peer.sock.sendall(data)
                sent[0] += len(data)

    with serving(script, "1.3", keylog_filename=str(log)) as server:
        yield server, sent


@pytest.mark.parametrize("kind", FLOODS)
def test_a_flood_while_a_request_waits(
    connect: Connect, papers: Papers, serving: Serving, tmp_path: Path, kind: str
) -> None:
    with (
        flooding(serving, tmp_path, kind, is_asked=True) as (server, sent),
        connect(server.url, security=papers.client(), timeout=1) as plc,
    ):
        assert plc.read_holding_registers(1, 1) == [1]
        with pytest.raises(ModbusError):
            plc.read_holding_registers(2, 1)
        server.script = Peer.serve
    assert kind == "records" or sent[0] < MUCH


@pytest.mark.parametrize("kind", FLOODS)
def test_a_flood_while_nothing_is_asked(
    connect: Connect, papers: Papers, serving: Serving, tmp_path: Path, kind: str
) -> None:
    with (
        flooding(serving, tmp_path, kind, is_asked=False) as (server, sent),
        connect(server.url, security=papers.client(), timeout=LONG, max_pause=0) as plc,
    ):
        assert plc.read_holding_registers(1, 1) == [1]
        if not isinstance(plc, Context):
            until(lambda: plc.state is State.DISCONNECTED)
        else:
            until(lambda: sent[0] > FULL)
        server.script = Peer.serve
        for each in range(3):
            assert plc.read_holding_registers(each, 1) == [each]
    assert sent[0] < MUCH


# --- much to send ---------------------------------------------------------------------------


@pytest.fixture
def small_buffers(monkeypatch: pytest.MonkeyPatch) -> None:
    """The system accepts what is sent in parts only."""
    preparing = TlsPort._preparing

    def prepare(port: TlsPort, made: socket.socket, deadline: float) -> Any:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        yield from preparing(port, made, deadline)

    monkeypatch.setattr(TlsPort, "_preparing", prepare)


@pytest.mark.usefixtures("small_buffers")
def test_much_is_sent_whole_and_in_order(
    connect: Connect, papers: Papers, serving: Serving
) -> None:
    """To a server that reads late and little by little."""
    count, got = 300, []

    def script(peer: Peer) -> None:
        peer.sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        time.sleep(0.1)
        while request := peer.request():
            got.append(request)
            peer.write(mbap(request, request[7:12]))

    with (
        serving(script) as server,
        connect(server.url, security=papers.client(), timeout=60, max_in_flight=256) as plc,
    ):
        asked = [pdu.WriteRegisters(each, (each,) * 120) for each in range(count)]
        assert plc.execute_many(asked, max_in_flight=256) == [None] * count
        assert plc.statistics.connects == 1
    assert [int.from_bytes(each[8:10], "big") for each in got] == list(range(count))
    for each in got:
        assert each[13:] == each[8:10] * 120


@pytest.mark.usefixtures("small_buffers")
def test_a_request_behind_much_else_that_is_unsent(
    connect: Connect, papers: Papers, serving: Serving, tmp_path: Path
) -> None:
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

    with (
        serving(script, "1.3", keylog_filename=str(log)) as server,
        connect(server.url, security=papers.client(), timeout=LONG) as plc,
    ):
        assert plc.read_holding_registers(1, 1) == [1]
        assert is_full.wait(LONG)
        assert plc.read_holding_registers(2, 1) == [2]
        assert plc.statistics.connects == 1


# --- nonsense -------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_nonsense_of_the_server_is_a_modbus_error(
    connect: Connect, papers: Papers, serving: Serving, seed: int
) -> None:
    """One byte that it sends, in the handshake or after it, is changed, lost, doubled or added."""
    chance = random.Random(seed)
    where, how, seen = 0, 0, 0

    def alter(data: bytes) -> list[bytes]:
        nonlocal seen
        at, seen = where - seen, seen + len(data)
        if not 0 <= at < len(data):
            return [data]
        changed = [
            bytes([data[at] ^ 1 << chance.randrange(8)]),
            b"",
            data[at : at + 1] * 2,
            chance.randbytes(chance.randrange(1, 400)),
        ][how]
        return [data[:at] + changed + data[at + 1 :]]

    before = descriptors()
    version = "1.2" if seed % 2 else "1.3"
    failed = 0
    with serving(version=version) as server, Relay(server.port, alter) as relay:
        security = papers.client()
        for _ in range(25):
            where, how, seen = int(1.01 ** chance.randrange(760)), chance.randrange(4), 0
            plc = connect(relay.url, security=security, timeout=0.15)
            try:
                for each in range(3):
                    assert plc.read_holding_registers(each, 1) == [each]
                assert plc.execute_many(reads(20)) == [[each] for each in range(20)]
            except ModbusError:
                failed += 1
            plc.close()
            relay.cut()
    assert failed
    until(lambda: descriptors() <= before + 2)
