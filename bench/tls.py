"""
What TLS costs the server: processor time for a request beside plain TCP, and for a handshake.

Client and certificates are Python's ssl and those of `libmodbus-py certificates`: EC P-256,
both sides show theirs.
"""

from __future__ import annotations

import socket
import ssl
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from bench.children import Child, processor_time
from libmodbus_py.tools.certificates import make, write

REQUEST = bytes.fromhex("0001 0000 0006 01 03 0000 000a")
ANSWER_SIZE = 29

# Connections, and requests in flight on each.
LOADS = ((1, 1), (8, 1), (100, 1), (1, 16), (8, 16))

HANDSHAKES = ("TLS 1.2", "TLS 1.3", "TLS 1.2, resumed", "TLS 1.3, resumed")

VERSIONS = {"TLS 1.2": ssl.TLSVersion.TLSv1_2, "TLS 1.3": ssl.TLSVersion.TLSv1_3}


@dataclass(frozen=True)
class Tls:
    """
    Attributes:
        requests: load -> microseconds of the server for a request, plain and over TLS.
        handshakes: kind -> the same for a connection with nothing but its handshake and
            one request.
    """

    requests: dict[str, tuple[float, float]]
    handshakes: dict[str, float]


def measure_tls(folder: Path, interpreter: str, rounds: int, seconds: float) -> Tls:
    """Measure both in turns; the medians of all rounds."""
    pki = folder / "pki"
    authority = make("benchmark", is_authority=True)
    identities = {
        "ca": authority,
        "server": make("server", authority, hosts=["127.0.0.1"]),
        "client": make("client", authority),
    }
    write(pki, identities)
    secret = "&".join(
        f"{name}={pki / file}"
        for name, file in (("cert", "server.pem"), ("key", "server-key.pem"), ("ca", "ca.pem"))
    )
    with ExitStack() as stack:
        places = [
            start(stack, interpreter, url)
            for url in ("tcp://127.0.0.1:0", f"tls://127.0.0.1:0?{secret}")
        ]
        requests = {
            f"{connections} x {depth}": medians(
                [
                    tuple(
                        cost_of_requests(*place, client, connections, depth, seconds)
                        for place, client in zip(places, (None, context(pki)), strict=True)
                    )
                    for _ in range(rounds)
                ]
            )
            for connections, depth in LOADS
        }
        handshakes = {
            kind: cost_of_handshakes(*places[1], pki, kind, seconds) for kind in HANDSHAKES
        }
    return Tls(requests, handshakes)


def medians(rounds: list[tuple[float, ...]]) -> tuple[float, ...]:
    return tuple(sorted(column)[len(column) // 2] for column in zip(*rounds, strict=True))


def start(stack: ExitStack, interpreter: str, url: str) -> tuple[int, int]:
    """Return its port and its process."""
    # All clients are at one address, and may have a tenth of the connections.
    command = [interpreter, "-m", "libmodbus_py", "serve", url, "--connections-per-address", "1000"]
    child = stack.enter_context(Child(command))
    return int(child.read_line().rpartition(":")[2]), child.pid


def context(pki: Path, version: ssl.TLSVersion | None = None) -> ssl.SSLContext:
    made = ssl.create_default_context(cafile=pki / "ca.pem")
    made.load_cert_chain(pki / "client.pem", pki / "client-key.pem")
    if version is not None:
        made.minimum_version = made.maximum_version = version
    return made


def connect(
    port: int, client: ssl.SSLContext | None, session: ssl.SSLSession | None = None
) -> socket.socket:
    made = socket.create_connection(("127.0.0.1", port), 20)
    made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if client is None:
        return made
    return client.wrap_socket(made, server_hostname="127.0.0.1", session=session)


def cost_of_requests(
    port: int,
    pid: int,
    client: ssl.SSLContext | None,
    connections: int,
    depth: int,
    seconds: float,
) -> float:
    with ExitStack() as stack:
        clients = [stack.enter_context(connect(port, client)) for _ in range(connections)]
        ask(clients, depth)
        count, before, end = 0, processor_time(pid), time.monotonic() + seconds
        while time.monotonic() < end:
            ask(clients, depth)
            count += connections * depth
        return (processor_time(pid) - before) / count * 1e6


def ask(clients: list[socket.socket], depth: int) -> None:
    for client in clients:
        client.sendall(REQUEST * depth)
    for client in clients:
        left = ANSWER_SIZE * depth
        while left:
            left -= len(client.recv(left))


def cost_of_handshakes(port: int, pid: int, pki: Path, kind: str, seconds: float) -> float:
    version, _, resumed = kind.partition(", ")
    client = context(pki, VERSIONS[version])
    session = handshake(port, client, None)
    count, before, end = 0, processor_time(pid), time.monotonic() + seconds
    while time.monotonic() < end:
        session = handshake(port, client, session if resumed else None)
        count += 1
    return (processor_time(pid) - before) / count * 1e6


def handshake(
    port: int, client: ssl.SSLContext, session: ssl.SSLSession | None
) -> ssl.SSLSession | None:
    with connect(port, client, session) as made:
        assert isinstance(made, ssl.SSLSocket)
        ask([made], 1)
        assert made.session_reused == (session is not None)
        return made.session
