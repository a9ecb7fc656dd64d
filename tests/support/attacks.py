"""
Attacks on a server, step by step, and a server that is a process of its own.

On a LAN `tests.simulation.attackers` carries them out, against processes `bench.attackers`.
"""

import contextlib
import os
import random
import resource
import signal
import socket
import ssl
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Self

from libmodbus_py.ports.endpoint import parse
from tests.support import certificates
from tests.support.certificates import Pki
from tests.support.driver import rtu

UNIT = 17
READ_ONE = bytes.fromhex("03 0000 0001")
READ_MOST = bytes.fromhex("03 0000 007d")

# Seconds that a process may take to start or to stop, and an answer to come.
PATIENCE = 25.0


def adu(pdu: bytes, transaction: int = 1, unit: int = UNIT, **changed: int) -> bytes:
    """Return a request or an answer over TCP, with fields of the header changed."""
    header = {"transaction": transaction, "protocol": 0, "length": 1 + len(pdu), "unit": unit}
    return struct.pack(">HHHB", *(header | changed).values()) + pdu


def connect(target: str | int, source: str = "") -> socket.socket:
    """
    Connect to a URL, or to a port of 127.0.0.1; over UDP, be ready to send datagrams there.
    `source`: the address that the connection comes from.
    """
    endpoint = parse(f"tcp://127.0.0.1:{target}" if isinstance(target, int) else target)
    place = (endpoint.host, endpoint.port)
    if endpoint.transport == "udp":
        family = socket.AF_INET6 if ":" in endpoint.host else socket.AF_INET
        connection = socket.socket(family, socket.SOCK_DGRAM)
        connection.settimeout(PATIENCE)
        connection.bind((source, 0))
        connection.connect(place)
    else:
        connection = socket.create_connection(place, PATIENCE, (source, 0))
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


def receive(connection: socket.socket, size: int) -> bytes:
    """Return `size` bytes, fewer if the connection is closed before; of datagrams a whole one."""
    if connection.type == socket.SOCK_DGRAM:
        return connection.recv(65_536)
    data = bytearray()
    while len(data) < size and (piece := connection.recv(size - len(data))):
        data += piece
    return bytes(data)


def ask(connection: socket.socket, request: bytes, answer: bytes) -> None:
    """Send a request, and check its answer."""
    connection.sendall(request)
    assert receive(connection, len(answer)) == answer


@contextlib.contextmanager
def descriptor_limit(limit: int | None = None) -> Iterator[int]:
    """
    Set the limit of descriptors of this process and of those it starts. `wanted`: None for as many
    as there may be. Return how many there are.
    """
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    soft = before[1] if limit is None else limit
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, before[1]))
    try:
        yield soft
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


class ServerProcess:
    """
    ``libmodbus-py serve`` on a free port; it must stop when it is told to. `pki`: for TLS, of the
    first endpoint; `attacked`: the scheme of another endpoint on 127.0.0.1; None for the same one.
    """

    def __init__(
        self,
        *options: str,
        url: str = "tcp://127.0.0.1:0",
        pki: Pki | None = None,
        attacked: str | None = None,
    ) -> None:
        if pki is not None:
            url = pki.url("tls://127.0.0.1:0", certificates.server())
        same = attacked is None or url.startswith(f"{attacked}:")
        self._urls = [url] if same else [url, f"{attacked}://127.0.0.1:0"]
        command = [sys.executable, "-m", "libmodbus_py", "serve", *self._urls, *options]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.pid = self._process.pid

    def __enter__(self) -> Self:
        assert self._process.stdout is not None
        ports = []
        for _ in self._urls:
            line = self._process.stdout.readline()
            assert line.startswith("listening on "), line
            ports.append(int(line.rpartition(":")[2]))
        self.port, self.attacked_port = ports[0], ports[-1]
        return self

    def __exit__(self, *_: object) -> None:
        self._process.send_signal(signal.SIGTERM)
        try:
            assert self._process.wait(PATIENCE) == 0
        finally:
            self._process.kill()
            self._process.communicate()

    def descriptors(self) -> int:
        return len(os.listdir(f"/proc/{self.pid}/fd"))

    def settled_descriptors(self) -> int:
        """How many it has when those who left are gone."""
        before, now = -1, self.descriptors()
        while now != before:
            time.sleep(0.05)
            before, now = now, self.descriptors()
        return now

    def threads(self) -> int:
        return len(os.listdir(f"/proc/{self.pid}/task"))

    def resident(self) -> int:
        """Bytes of memory that are its own or shared."""
        pages = int(Path(f"/proc/{self.pid}/statm").read_text().split()[1])
        return pages * resource.getpagesize()

    def has_descriptors(self, count: int) -> bool:
        """Return True if it soon has no more of them."""
        deadline = time.monotonic() + PATIENCE
        while self.descriptors() > count:
            if time.monotonic() > deadline:
                return False
            time.sleep(0.01)
        return True


ANSWER_ONE = bytes.fromhex("03 02 0000")
BLOCK = 100


def churn(port: int, cycles: int) -> None:
    """Connect, ask, close."""
    answer = adu(ANSWER_ONE)
    for number in range(cycles):
        # From many addresses, so that ports that were used just now do not run out.
        source = (f"127.3.0.{1 + number % 250}", 0)
        with socket.create_connection(("127.0.0.1", port), PATIENCE, source) as connection:
            connection.sendall(adu(READ_ONE))
            assert receive(connection, len(answer)) == answer


def pipeline(port: int, requests: int) -> None:
    """Ask on one connection, a hundred requests at a time."""
    with connect(port) as connection:
        for first in range(0, requests, BLOCK):
            numbers = [number & 0xFFFF for number in range(first, first + BLOCK)]
            connection.sendall(b"".join(adu(READ_ONE, number) for number in numbers))
            answers = b"".join(adu(ANSWER_ONE, number) for number in numbers)
            assert receive(connection, len(answers)) == answers


class Step(NamedTuple):
    """What an attacker sends, how many bytes it waits for then, and how many seconds."""

    send: bytes = b""
    answer: int = 0
    pause: float = 0.0


# What one connection does; then it is closed, and another one made.
Script = Callable[[], Iterator[Step]]


@dataclass(frozen=True)
class Attack:
    """`on_tls`: whether it is for a server that speaks TLS."""

    name: str
    connections: int
    script: Script
    reads: bool = True
    sends: bool = True
    scheme: str = "tcp"

    def pki(self, directory: Path) -> Pki | None:
        """Return the certificates of the server and of the innocent client, in this directory."""
        return Pki(directory) if self.scheme == "tls" else None


def _idle() -> Iterator[Step]:
    while True:
        yield Step(pause=60)


def _byte_by_byte() -> Iterator[Step]:
    while True:
        for byte in adu(READ_ONE):
            yield Step(bytes([byte]), pause=1)


def _without_end(pdu: bytes) -> Script:
    block = b"".join(adu(pdu, transaction) for transaction in range(500))

    def script() -> Iterator[Step]:
        while True:
            yield Step(block)

    return script


def _random_bytes() -> Iterator[Step]:
    while True:
        yield Step(random.randbytes(4096))


def _half_a_frame() -> Iterator[Step]:
    yield Step(adu(READ_ONE)[:9])


def _nothing() -> Iterator[Step]:
    yield from ()


def _sixteen_at_once() -> Iterator[Step]:
    block = b"".join(adu(READ_ONE, transaction) for transaction in range(16))
    while True:
        yield Step(block, answer=16 * 11)


def _in_twelve_segments() -> Iterator[Step]:
    *begin, last = (bytes([byte]) for byte in adu(READ_ONE))
    while True:
        for byte in begin:
            yield Step(byte)
        yield Step(last, answer=11)


def _hidden_requests() -> Iterator[Step]:
    """As many of the shortest requests as fit behind what looks like the head of a long one."""
    block = bytes.fromhex("11 10 0000 007b f6") + rtu("11 11") * 62
    while True:
        yield Step(pause=0.3)  # so that all of them come at once
        yield Step(block)


def client_hello() -> bytes:
    """Return the first bytes that Python's ssl sends."""
    outgoing = ssl.MemoryBIO()
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    tls = context.wrap_bio(ssl.MemoryBIO(), outgoing, server_hostname="localhost")
    with contextlib.suppress(ssl.SSLWantReadError):
        tls.do_handshake()
    return outgoing.read()


def _half_a_handshake() -> Iterator[Step]:
    yield Step(client_hello(), pause=60)


def _hello_after_hello() -> Iterator[Step]:
    # The server has signed something by then.
    yield Step(client_hello(), answer=500)


ATTACKS = [
    Attack("1000 idle connections", 1000, _idle, sends=False),
    Attack("200 that send a byte a second", 200, _byte_by_byte),
    Attack("50 that never read", 50, _without_end(READ_MOST), reads=False),
    Attack("flood of unknown functions", 20, _without_end(b"\x63\x01\x02\x03")),
    Attack("flood of illegal counts", 20, _without_end(bytes.fromhex("03 0000 ffff"))),
    Attack("flood of random bytes", 20, _random_bytes),
    Attack("flood of half frames", 20, _half_a_frame),
    Attack("storm of connections", 20, _nothing, sends=False),
    Attack("16 requests in a segment", 20, _sixteen_at_once),
    Attack("1000 that hide requests", 1000, _hidden_requests, scheme="rtu+tcp"),
    Attack("a request in 12 segments", 20, _in_twelve_segments),
    Attack("half-open TLS handshakes", 1000, _half_a_handshake, scheme="tls"),
    Attack("TLS handshake flood", 20, _hello_after_hello, scheme="tls"),
    Attack("idle and no TLS handshake", 1000, _idle, sends=False, scheme="tls"),
]
