"""
Requests over TLS: records cut them anywhere, and whom the server closes gets a goodbye.

R-nn are the requirements of MB-TCP-Security-v36. The limits of clients over TLS stand in the tests
of these limits.
"""

import itertools
import ssl
import struct
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import Any

import pytest

from libmodbus_py import Device, Fault, Limits, Mapping
from tests.simulation.lan import Lan
from tests.support import certificates
from tests.support.attacks import ANSWER_ONE, READ_MOST, READ_ONE, adu
from tests.support.certificates import Pki
from tests.support.interop import our_tls_server
from tests.support.lan_server import KINDS, NEVER
from tests.support.tls import (
    ONE,
    ONE_ANSWER,
    VERSION,
    VERSIONS,
    TlsClient,
    connected,
    context,
    serving,
    talking,
)

MOST_ANSWER = adu(bytes([3, 250]) + bytes(250))


@pytest.fixture(params=KINDS)
def way(request: pytest.FixtureRequest) -> dict[str, Any]:
    """What `serving` needs to answer in C by the chunk, through hooks, or with faults."""
    hook = (lambda access: None) if request.param == "hooked" else None
    faults = {None: [NEVER]} if request.param == "faulty" else None
    return {"device": Device(Mapping(10, 10, 1000, 1000), before_read=hook), "faults": faults}


def requests(count: int) -> bytes:
    return b"".join(adu(READ_ONE, number) for number in range(count))


def answers(count: int) -> bytes:
    return b"".join(adu(ANSWER_ONE, number) for number in range(count))


@VERSION
@pytest.mark.parametrize(
    "cut", ["a record", "a byte in a record", "a record in bytes", "two records", "one and a half"]
)
def test_records_may_cut_requests_anywhere(
    lan: Lan, pki: Pki, way: dict[str, Any], cut: str, version: ssl.TLSVersion
) -> None:
    data = requests(50)
    with talking(lan, pki, version=version, **way) as (server, client):
        if cut == "a record":
            client.send(data)
        elif cut == "a byte in a record":
            client.send(*(bytes([byte]) for byte in data))
        elif cut == "a record in bytes":
            for byte in client.encrypt(data):
                client.socket.send(bytes([byte]))
        else:
            end = 7 if cut == "two records" else 18
            client.send(data[:end])
            lan.pass_time(1)
            client.send(data[end:])
        assert client.receive(len(answers(50))) == answers(50)
        assert server.statistics.requests == 50


@pytest.mark.parametrize("rate", [None, 1000])
@pytest.mark.parametrize("cuts", [[12], [12, 24], [12, 30], [12, 36, 40]], ids=repr)
def test_records_read_together_are_carried_out_in_order(
    lan: Lan, pki: Pki, way: dict[str, Any], cuts: list[int], rate: int | None
) -> None:
    """The first holds one request and nothing else; what follows does not overtake it."""
    pdus = ("06 0000 0005", "03 0000 0001", "06 0000 0006", "03 0000 0001")
    answers = ("06 0000 0005", "03 02 0005", "06 0000 0006", "03 02 0006")
    requests, response = (
        b"".join(adu(bytes.fromhex(pdu), number) for number, pdu in enumerate(answer))
        for answer in (pdus, answers)
    )
    edges = [0, *cuts, len(requests)]
    pieces = [requests[start:end] for start, end in itertools.pairwise(edges)]
    limits = Limits(requests_per_second=rate)
    with talking(lan, pki, **way, limits=limits) as (server, client):
        client.send(*pieces)
        assert client.receive(len(response)) == response
        assert server.statistics.requests == 4


def test_a_record_full_of_requests_is_answered_in_slices(lan: Lan, pki: Pki) -> None:
    """Other clients take turns in between: a record can contain 1365 requests."""
    turns: list[str] = []
    device = Device(
        Mapping(10, 10, 1000, 1000), before_read=lambda access: turns.append(access.peer)
    )
    count = 16_384 // 12
    with (
        serving(pki, device) as (_, port),
        connected(lan, pki, port) as greedy,
        connected(lan, pki, port) as modest,
    ):
        record = greedy.encrypt(requests(count))
        greedy.socket.sendall(record[:-1])
        lan.pass_time(1)  # all but the last byte is with the server
        modest.send(ONE)
        greedy.socket.sendall(record[-1:])
        modest.send(ONE)
        assert modest.receive(2 * len(ONE_ANSWER)) == 2 * ONE_ANSWER
        assert greedy.receive(len(answers(count))) == answers(count)
    modest_name = min(set(turns), key=turns.count)
    runs = "".join("m" if name == modest_name else "g" for name in turns).split("m")
    assert turns.count(modest_name) == 2
    assert len(runs[-1]) > count // 2, [len(run) for run in runs]  # it did not wait for all


@VERSION
def test_requests_sent_with_the_end_of_the_handshake_are_answered(
    lan: Lan, pki: Pki, version: ssl.TLSVersion
) -> None:
    context_ = context(pki, certificates.client(), version)
    with serving(pki) as (_, port), TlsClient(port, context_, lan=lan) as client:
        client.socket.sendall(client.hello())
        # The client's own end of the handshake, and 50 requests behind it, in one segment.
        while True:
            client._incoming.write(client.socket.recv(65536))
            try:
                client.tls.do_handshake()
                break
            except ssl.SSLWantReadError:
                if version == VERSIONS["1.2"]:
                    client._flush()
        client.send(requests(50))
        assert client.receive(len(answers(50))) == answers(50)


@VERSION
def test_a_close_notify_after_a_request_gets_the_answer_and_a_close_notify(
    lan: Lan, pki: Pki, way: dict[str, Any], version: ssl.TLSVersion
) -> None:
    with serving(pki, **way) as (server, port):
        with connected(lan, pki, port, version) as other:
            for count in (1, 2, 1365):
                with connected(lan, pki, port, version) as client:
                    data = client.encrypt(requests(count))
                    # In one segment, if it is short: both are received in one turn.
                    client.socket.sendall(data + client.goodbye())
                    other.send(ONE)
                    received = raw_records(client)
                    assert len(received) > len(answers(count))
                    assert other.receive(len(ONE_ANSWER)) == ONE_ANSWER
        assert lan.until(lambda: server.statistics.connections == 0)
        assert server.statistics.requests == 1 + 2 + 1365 + 3
        assert server.statistics.closed_out_of_step == 0


def raw_records(client: TlsClient) -> bytes:
    """Return what the server sends until it closes; ssl reads nothing after its own goodbye."""
    data = b""
    while piece := client.socket.recv(65536):
        data += piece
    return data


def test_records_after_a_close_notify_are_ignored(lan: Lan, pki: Pki) -> None:
    with talking(lan, pki) as (server, client):
        late = client.encrypt(ONE)
        client.socket.sendall(client.goodbye() + late * 3)
        raw_records(client)
        assert server.statistics.requests == 0


def test_delayed_answers_come_in_order(lan: Lan, pki: Pki) -> None:
    late = {None: [Fault("delay", seconds=200, every=3)]}
    with talking(lan, pki, faults=late) as (_, client):
        client.send(requests(4), *(adu(READ_ONE, number) for number in range(4, 8)))
        assert client.receive(len(answers(8))) == answers(8)


def test_a_client_that_reads_slowly_gets_every_answer_over_tls(
    lan: Lan, pki: Pki, way: dict[str, Any]
) -> None:
    """A record has 350 kB of answers; two are more than the network in memory carries."""
    count, limits = 1365, Limits(max_unsent=10_000)
    block = b"".join(adu(READ_MOST, number) for number in range(count))
    with talking(lan, pki, **way, limits=limits) as (server, client):
        for _ in range(2):
            client.send(block)
        assert lan.until(lambda: server.statistics.paused > 0)
        before = server.statistics.requests
        lan.pass_time(600)
        assert server.statistics.requests == before < 2 * count
        for number in itertools.chain(range(count), range(count)):
            answer = client.receive(len(MOST_ANSWER))
            assert answer == struct.pack(">H", number) + MOST_ANSWER[2:]


def test_requests_per_second_hold_within_a_record(lan: Lan, pki: Pki, way: dict[str, Any]):
    limits = Limits(requests_per_second=200)
    with talking(lan, pki, limits=limits, **way) as (server, client):
        begin = lan.now
        client.send(requests(800))
        assert client.receive(len(answers(800))) == answers(800)
        # 200 at once, the rest at 200 a second; the last slice is not waited for.
        assert 2.0 < lan.now - begin <= 3.01
        assert server.statistics.throttled > 1


@pytest.mark.parametrize("most", [512, 1024])
def test_a_client_may_ask_for_short_records(pki: Pki, most: int) -> None:
    """R-57, R-58; Python has no API to ask for them, so openssl asks."""
    with our_tls_server(pki, Device(Mapping(10, 10, 1000, 1000))) as wire:
        files = pki.files(certificates.client())
        command = (
            *("openssl", "s_client", "-connect", f"127.0.0.1:{wire.port}", "-CAfile", pki.ca),
            *("-cert", files.cert, "-key", files.key, "-quiet", "-maxfraglen", str(most)),
            "-tls1_2",
        )
        with subprocess.Popen(
            [*map(str, command)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        ) as process:
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.write(b"".join(adu(READ_MOST, number) for number in range(20)))
            process.stdin.flush()
            data = process.stdout.read(20 * len(MOST_ANSWER))
            process.kill()
        response = b"".join(struct.pack(">H", number) + MOST_ANSWER[2:] for number in range(20))
        assert data == response
        sizes = [size for kind, size in records(wire.sent_by("server")) if kind == 23]
    assert len(sizes) >= 20 * len(MOST_ANSWER) // most
    # 8 bytes of nonce and 16 of tag.
    assert max(sizes) <= most + 24


def records(stream: bytes) -> Iterator[tuple[int, int]]:
    """Types and lengths."""
    while len(stream) >= 5:
        kind, _, size = struct.unpack_from(">BHH", stream)
        yield kind, size
        stream = stream[5 + size :]


def record_of(size: int) -> Callable[[TlsClient], object]:
    """Return what sends so many bytes of a record."""
    return lambda client: client.socket.send(client.encrypt(ONE)[:size])


# What a client does -> the seconds until the server closes, and what it counts then.
ENDS: dict[str, tuple[Callable[[TlsClient], object], float, str]] = {
    "half a frame": (lambda client: client.send(ONE[:9]), 30, "closed_slow"),
    "half a record": (record_of(20), 30, "closed_slow"),
    "half a header": (record_of(3), 30, "closed_slow"),
    "no header": (lambda client: client.send(b"\0\1\0\0\xff\xff\1\3"), 0, "closed_out_of_step"),
    "nothing": (lambda client: None, 300, "closed_idle"),
    "a fault": (lambda client: client.send(adu(b"\x07")), 0, ""),
}


@VERSION
@pytest.mark.parametrize("what", ENDS)
def test_a_client_that_is_closed_gets_close_notify(
    lan: Lan, pki: Pki, what: str, version: ssl.TLSVersion
) -> None:
    act, seconds, counter = ENDS[what]
    limits = Limits(frame_timeout=30, idle_timeout=300)
    faults = {None: [Fault("disconnect", function=7)]} if what == "a fault" else None
    with talking(lan, pki, version=version, limits=limits, faults=faults) as (server, client):
        assert client.is_answered()
        start = lan.now
        act(client)
        assert client.read() == b""
        assert seconds <= lan.now - start <= seconds + 1.01
        statistics = asdict(server.statistics)
        counts = {name: count for name, count in statistics.items() if name.startswith("closed")}
        assert counts == {name: int(name == counter) for name in counts}


@VERSION
def test_a_server_that_ends_sends_close_notify(lan: Lan, pki: Pki, version: ssl.TLSVersion):
    with serving(pki) as (_, port):
        client = connected(lan, pki, port, version)
        assert client.is_answered()
    with client:
        assert client.read() == b""
