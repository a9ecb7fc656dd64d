"""TLS of the hostile, the slow and the lost: nothing is left, others are served."""

import array
import contextlib
import fcntl
import random
import socket
import ssl
import struct
import subprocess
import termios
import time
import tracemalloc
from collections.abc import Callable
from functools import partial

import pytest

from libmodbus_py import Limits
from tests.simulation.lan import Lan
from tests.support import certificates
from tests.support.attacks import ServerProcess, connect
from tests.support.certificates import Pki
from tests.support.tls import (
    ONE,
    ONE_ANSWER,
    VERSION,
    VERSIONS,
    TlsClient,
    closed,
    connected,
    context,
    hello,
    is_served,
    nothing_loud,
    reset,
    serving,
    talking,
    wait_until,
)
from tests.support.tls_clients import descriptors


def record(kind: int, data: bytes) -> bytes:
    return struct.pack(">BHH", kind, 0x0303, len(data)) + data


def huge_hello() -> bytes:
    """A well-formed ClientHello of 130 kB, most of it an extension nobody knows."""
    padding = b"".join(
        struct.pack(">HH", 0xFE00 + number, 65_000 // 8) + bytes(65_000 // 8) for number in range(7)
    )
    body = b"\x03\x03" + bytes(32) + b"\0" + b"\0\2\xc0\x2b" + b"\1\0"
    body += struct.pack(">H", len(padding)) + padding
    message = b"\1" + struct.pack(">I", len(body))[1:] + body
    return b"".join(record(22, message[at : at + 16_000]) for at in range(0, len(message), 16_000))


SSLV2_HELLO = bytes.fromhex(
    "802e 01 0002 0015 0000 0010 0100800200800300800400800600400700c0"
) + bytes(16)

GARBAGE: dict[str, Callable[[], bytes]] = {
    "random": lambda: random.Random(1).randbytes(10_000),
    "zeros": lambda: bytes(100_000),
    "plain Modbus": lambda: ONE * 10,
    "HTTP": lambda: b"GET / HTTP/1.1\r\nHost: plc\r\n\r\n",
    "SSLv2": lambda: SSLV2_HELLO,
    "huge hello": huge_hello,
    "hello of 16 MB": lambda: record(22, b"\1\xff\xff\xff" + bytes(16_000)) + bytes(200_000),
    "empty records": lambda: record(22, b"") * 20_000,
    "alerts": lambda: record(21, b"\1\0") * 15_000,
    "warnings": lambda: record(21, b"\1\x5a") * 15_000,
    "heartbeats": lambda: record(24, b"\1\x40\0") * 12_000,
    "data": lambda: record(23, bytes(100)) * 1000,
    "change cipher spec": lambda: record(20, b"\1") * 16_000,
    "an end": lambda: b"",
}


@pytest.mark.parametrize("what", GARBAGE)
@pytest.mark.parametrize("behind", ["at once", "behind a hello"])
def test_bytes_that_are_no_handshake_end_the_connection(lan: Lan, pki: Pki, what, behind, caplog):
    data = (hello(pki) if behind != "at once" else b"") + GARBAGE[what]()
    limits = Limits(handshake_timeout=1)
    with nothing_loud(caplog), serving(pki, limits=limits) as (server, port):
        with lan.client(port) as hostile:
            with contextlib.suppress(OSError):
                hostile.sendall(data)
                hostile.shutdown(socket.SHUT_WR)
            closed(hostile)
        statistics = server.statistics
        assert lan.until(lambda: statistics.connections == 0)
        assert statistics.handshakes == statistics.requests == 0
        assert is_served(pki, port, lan)


def test_a_damaged_client_hello_has_no_effect_on_others(lan: Lan, pki: Pki, caplog) -> None:
    """Bytes of a good one are changed, a few at a time."""
    good, chance = hello(pki), random.Random(7)
    with nothing_loud(caplog), serving(pki) as (server, port):
        for _ in range(200):
            bad = bytearray(good)
            for _ in range(chance.choice((1, 2, 8))):
                bad[chance.randrange(len(bad))] = chance.randrange(256)
            with lan.client(port) as hostile:
                hostile.sendall(bytes(bad))
                with contextlib.suppress(OSError):  # the server may have closed before
                    hostile.shutdown(socket.SHUT_WR)
                closed(hostile)
        assert lan.until(lambda: server.statistics.connections == 0)
        assert is_served(pki, port, lan)


def test_resets_at_any_time_leave_nothing(pki: Pki, caplog: pytest.LogCaptureFixture) -> None:
    first = hello(pki)
    contexts = [context(pki, certificates.client(), version) for version in VERSIONS.values()]
    with nothing_loud(caplog), serving(pki) as (server, port):
        is_served(pki, port)
        assert wait_until(lambda: server.statistics.connections == 0)
        before = descriptors()
        for data in (b"", first[:100], first, first + first):
            for _ in range(30):
                hostile = connect(port)
                hostile.sendall(data)
                reset(hostile)
        for context_ in contexts * 20:
            client = TlsClient(port, context_).handshake()
            client.send(ONE * 100)
            reset(client.socket)
        assert wait_until(lambda: server.statistics.connections == 0)
        assert wait_until(lambda: descriptors() <= before)
        assert is_served(pki, port)


def flipped(data: bytes) -> bytes:
    return data[:-1] + bytes([data[-1] ^ 1])


AFTER: dict[str, Callable[[TlsClient], bytes]] = {
    "garbage": lambda client: random.Random(1).randbytes(10_000),
    "plain Modbus": lambda client: ONE,
    "bad check": lambda client: flipped(client.encrypt(ONE)),
    "replayed": lambda client: client.encrypt(ONE) * 2,
    "plain alert": lambda client: record(21, b"\2\x28"),
    "empty records": lambda client: record(23, b"") * 1000,
    "heartbeats": lambda client: record(24, b"\1\x40\0") * 1000,
    "another hello": lambda client: record(22, b"\1\0\0\0") * 1000,
    "change cipher spec": lambda client: record(20, b"\1") * 1000,
    "huge record": lambda client: struct.pack(">BHH", 23, 0x0303, 65_535) + bytes(65_535),
}


@VERSION
@pytest.mark.parametrize("what", AFTER)
def test_an_invalid_record_ends_only_its_connection(
    lan: Lan, pki: Pki, what: str, version: ssl.TLSVersion, caplog: pytest.LogCaptureFixture
) -> None:
    with (
        nothing_loud(caplog),
        serving(pki) as (server, port),
        connected(lan, pki, port, version) as innocent,
        connected(lan, pki, port, version) as hostile,
    ):
        assert hostile.is_answered()
        # Behind a request, in one segment: what fails must not cost others their answers.
        request = hostile.encrypt(ONE)
        innocent.send(ONE)
        with contextlib.suppress(OSError):
            hostile.socket.sendall(request + AFTER[what](hostile))
            innocent.send(ONE)
            hostile.socket.shutdown(socket.SHUT_WR)
        closed(hostile.socket)
        assert innocent.receive(2 * len(ONE_ANSWER)) == 2 * ONE_ANSWER
        assert lan.until(lambda: server.statistics.connections == 1)
        assert innocent.is_answered()


def test_a_bad_record_is_answered_by_an_alert(lan: Lan, pki: Pki) -> None:
    with talking(lan, pki) as (server, client):
        client.socket.sendall(flipped(client.encrypt(ONE)))
        with pytest.raises(ssl.SSLError, match="BAD_RECORD_MAC"):
            client.read()
        assert server.statistics.closed_out_of_step == 1


def _has_read(process: subprocess.Popen[bytes]) -> bool:
    """Return True if a process has read what was written to it, or has ended."""
    size = array.array("i", [0])
    fcntl.ioctl(process.stdin, termios.FIONREAD, size)
    return not size[0] or process.poll() is not None


@pytest.mark.parametrize("command", ["R", "K", "k"])
def test_openssl_cannot_renegotiate_but_can_change_its_keys(pki: Pki, command: str) -> None:
    """R: negotiation; K: new keys both ways, k: its own (TLS 1.3)."""
    files = pki.files(certificates.client())
    is_negotiation = command == "R"
    with serving(pki) as (server, port):
        line = (
            *("openssl", "s_client", "-connect", f"127.0.0.1:{port}", "-CAfile", pki.ca),
            *("-cert", files.cert, "-key", files.key),
            "-tls1_2" if is_negotiation else "-tls1_3",
        )
        with subprocess.Popen(
            [*map(str, line)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            bufsize=0,  # the write is not tried again
        ) as process:
            assert process.stdin is not None
            assert process.stdout is not None
            for _ in range(200):
                with contextlib.suppress(BrokenPipeError):
                    process.stdin.write(command.encode() + b"\n")
                if is_negotiation and server.statistics.handshakes:
                    break
                # What it reads together, it takes for one command.
                assert wait_until(partial(_has_read, process))
            if not is_negotiation:
                process.stdin.write(ONE)  # no line that it takes for a command
                assert wait_until(lambda: server.statistics.requests == 1)
            output, end = b"", b"no renegotiation" if is_negotiation else ONE_ANSWER
            while end not in output and (piece := process.stdout.read(4096)):
                output += piece
            process.kill()
        if is_negotiation:
            assert b"Secure Renegotiation IS supported" in output
            assert b"RENEGOTIATING" in output
            assert b"no renegotiation" in output
        else:
            assert ONE_ANSWER in output
            assert b"KEYUPDATE" in output
        assert server.statistics.handshakes == 1
        assert wait_until(lambda: server.statistics.connections == 0)
        assert is_served(pki, port)


def test_a_fatal_alert_in_the_middle_of_a_session_ends_it(lan: Lan, pki: Pki) -> None:
    """Python's ssl sends an alert when it receives bytes that are no record."""
    with talking(lan, pki) as (server, client):
        assert client.is_answered()
        client._incoming.write(record(23, bytes(40)))
        with pytest.raises(ssl.SSLError):
            client.tls.read(100)
        client._flush()
        closed(client.socket)
        assert lan.until(lambda: server.statistics.connections == 0)
        assert server.statistics.closed_out_of_step == 1


def test_closed_connections_leave_no_memory(pki: Pki) -> None:
    """Sessions that ended well, badly, early, and those that were refused."""
    good = context(pki, certificates.client())
    bad = context(pki, certificates.client(issuer=certificates.foreign_authority()))
    first = hello(pki)

    def come_and_go() -> None:
        with TlsClient(port, good).handshake() as client:
            assert client.is_answered()
        with TlsClient(port, bad) as client, contextlib.suppress(ssl.SSLError):
            client.handshake().ask(ONE, 1)
        with connect(port) as hostile:
            hostile.sendall(first)
        with connect(port) as hostile:
            hostile.sendall(b"GET / HTTP/1.1\r\n\r\n")
            closed(hostile)

    with serving(pki) as (server, port):
        for _ in range(10):
            come_and_go()
        tracemalloc.start()
        try:
            for _ in range(10):
                come_and_go()
            assert wait_until(lambda: server.statistics.connections == 0)
            before = tracemalloc.get_traced_memory()[0]
            for _ in range(40):
                come_and_go()
            assert wait_until(lambda: server.statistics.connections == 0)
            assert tracemalloc.get_traced_memory()[0] - before < 20_000
        finally:
            tracemalloc.stop()


def test_a_server_that_ends_leaves_no_handshake(pki: Pki, caplog: pytest.LogCaptureFixture) -> None:
    first = hello(pki)
    context_ = context(pki, certificates.client())
    before = descriptors()
    with nothing_loud(caplog):
        for pause in (0.0, 0.002, 0.01, 0.05):
            with contextlib.ExitStack() as stack:
                with serving(pki) as (server, port):
                    clients = [stack.enter_context(TlsClient(port, context_)) for _ in range(3)]
                    for client in clients:
                        client.handshake()
                    # The client's end of TLS 1.3 is through before the server's.
                    assert wait_until(lambda: server.statistics.handshakes == 3)
                    for client in clients:
                        client.send(ONE)
                    sockets = [stack.enter_context(connect(port)) for _ in range(60)]
                    for socket in sockets:
                        socket.sendall(first)
                    time.sleep(pause)
                for socket in sockets:
                    closed(socket)
                for client in clients:
                    while client.read():
                        pass
    assert wait_until(lambda: descriptors() <= before)


@pytest.mark.parametrize("what", ["half open", "idle"])
@pytest.mark.filterwarnings("ignore:record_property is incompatible")
def test_a_thousand_connections_fit_into_the_memory_limit(pki: Pki, what, record_property) -> None:
    url = pki.url("tls://127.0.0.1:0", certificates.server())
    context_, first = context(pki, certificates.client()), hello(pki)
    count, some = 200, 20
    # All of them within the time that a handshake may take.
    with ServerProcess(url=url) as server, contextlib.ExitStack() as stack:

        def add(number: int) -> None:
            for _ in range(number):
                if what == "idle":
                    stack.enter_context(TlsClient(server.port, context_)).handshake()
                else:
                    each = stack.enter_context(connect(server.port))
                    each.sendall(first)
                    assert each.recv(1)

        add(some)
        before = server.resident()
        add(count)
        grown = (server.resident() - before) // count
        record_property("bytes per connection", grown)
        assert grown < 100_000
        assert is_served(pki, server.port)
