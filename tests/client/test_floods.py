"""Peers that send without end: the wait ends with the timeout, and few of the bytes are kept."""

import contextlib
import random
import threading
import tracemalloc
from collections.abc import Callable, Iterator

import pytest

from libmodbus_py import ModbusError
from tests.simulation.network import Network
from tests.support.clients import World, asking, making, read
from tests.support.peers import OnRequest, Write, peer_at

# An answer whose id no request has.
STRANGE = bytes.fromhex("FFFF0000000501030200AA")
NOISE = random.Random(1).randbytes(2048)

FLOODS: dict[str, tuple[str, bytes]] = {
    "digits": ("ascii+tcp", b"0123456789ABCDEF" * 128),
    "colons and digits": ("ascii+tcp", b":" + b"0123456789ABCDEF" * 128),
    "frames with other ids": ("tcp", STRANGE * 186),
    "headers of another protocol": ("tcp", bytes.fromhex("800100070005010302000A") * 186),
    "datagrams": ("udp", STRANGE),
    "large datagrams": ("udp", bytes(60_000)),
    "noise": ("rtu+tcp", NOISE),
    "starts of frames": ("rtu+tcp", b"\x01\x03\xfa" * 682),
    "frames of another unit": ("rtu+tcp", bytes.fromhex("09030200AAD9FB") * 292),
}


def failure(act: Callable[[], object]) -> ModbusError:
    with pytest.raises(ModbusError) as caught:
        act()
    return caught.value


def flooding(network: Network, data: bytes, pause: float) -> OnRequest:
    """Send the same for ever, from the first request on, on each connection."""
    connections: set[int] = set()

    def send(write: Write) -> None:
        write(data)
        network.events.after(pause, send, write)

    def on_request(request: bytes, write: Write) -> None:
        connection = id(getattr(write, "__self__", write))
        if connection not in connections:
            connections.add(connection)
            send(write)

    return on_request


@pytest.mark.parametrize("flood", FLOODS)
def test_a_flood_costs_neither_time_nor_memory(flood: str, world: World) -> None:
    scheme, data = FLOODS[flood]
    peer = world.peer(scheme, flooding(world.network, data, 0.005))
    # Where nothing tells an answer from the next one, the line must fall silent first: at most a
    # time-out is waited for that. Such a connection is left; then the unit rests for another one.
    most_waits = 1 if scheme in ("tcp", "udp") else 3
    with world.connect(peer.url, timeout=0.2) as client:
        for attempt in range(2):
            before = world.now
            error = failure(lambda: read(client, 1))
            assert world.now - before <= 0.2 * (most_waits if attempt else 1) + 0.006
            assert len(error.received) <= 600
            assert len(str(error)) < 300
        tracemalloc.start()
        try:
            failure(lambda: read(client, 1))
            size, most = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    assert size < 64 * 1024
    assert most < 1024 * 1024  # the bytes read in one turn, and those that the network itself keeps


@contextlib.contextmanager
def pouring(scheme: str, data: bytes) -> Iterator[str]:
    """A real peer that sends as fast as it can, from the first request on; gives its URL."""
    over = threading.Event()

    def on_request(request: bytes, write: Write) -> None:
        while not over.is_set():
            write(data)

    with peer_at(scheme, on_request) as peer:
        try:
            yield peer.url
        finally:
            over.set()


@pytest.mark.parametrize("kind", ["blocking", "asyncio"])
@pytest.mark.parametrize(
    ("scheme", "data"), [("tcp", STRANGE * 4096), ("udp", STRANGE), ("rtu+tcp", NOISE * 32)]
)
def test_a_flood_without_pauses_ends_with_the_timeout(scheme: str, data: bytes, kind: str) -> None:
    """There is always more to be read: only the clock ends the wait."""
    with pouring(scheme, data) as url, asking(kind, url, timeout=0.1) as client:
        error = failure(lambda: read(client, 1))
        assert len(error.received) <= 600


@pytest.mark.parametrize("scheme", ["rtu", "ascii"])
@pytest.mark.parametrize("pause", [0.001, 0.02])
def test_a_line_that_is_never_silent_ends_the_wait_in_time(pause: float, scheme: str, world: World):
    """From the first request on, and while it waits for the silence before its frame."""
    noise = b"0123456789ABCDEF" if scheme == "ascii" else bytes(range(0x80, 0x90))
    with world.client_of(scheme, flooding(world.network, noise, pause), timeout=0.2) as client:
        for _ in range(3):
            before = world.now
            error = failure(lambda: read(client, 1))
            assert world.now - before <= 2 * 0.2 + 0.025
            assert len(error.received) <= 600
            assert len(str(error)) < 300


@pytest.mark.parametrize(
    ("scheme", "data", "pause"),
    [
        ("tcp", STRANGE * 300, 0.01),
        ("udp", STRANGE, 0.001),
        ("rtu+tcp", STRANGE * 300, 0.01),
        ("rtu", bytes(range(0x80, 0x90)) * 16, 0.03),
    ],
)
def test_an_idle_client_leaves_a_flood_in_the_system(scheme, data, pause, monkeypatch) -> None:
    """An event loop that handled each byte would do nothing else."""
    with (
        making("asyncio") as world,
        world.client_of(scheme, flooding(world.network, data, pause), timeout=0.1) as client,
    ):
        failure(lambda: read(client, 1))
        world.sleep(30.0)  # 64 KiB take 8 s
        port, reads = client._driver._port, []
        receive = port.receive
        monkeypatch.setattr(port, "receive", lambda: reads.append(1) or receive())
        world.sleep(30.0)
        assert not reads
        failure(lambda: read(client, 1))
        assert reads


def test_a_client_that_left_a_flood_unread_reads_the_next_answer() -> None:
    """On a serial line; connections of sockets end. The response to a write repeats the request."""
    with making("asyncio") as world:
        data, end = bytes(range(0x80, 0x90)) * 16, world.now + 60.0
        flood = flooding(world.network, data, 0.03)

        def on_request(request: bytes, write: Write) -> None:
            if world.now < end:
                flood(request, lambda data: write(data) if world.now < end else None)
            else:
                write(request)

        with world.client_of("rtu", on_request, timeout=0.1, retries=0) as client:
            failure(lambda: read(client, 1))
            world.sleep(90.0)
            client.write_register(1, 7)
