"""Clients over UDP: datagrams that are lost, late, doubled, damaged, empty or another's."""

import contextlib
import errno
import socket
from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import (
    Device,
    FrameError,
    Mapping,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    Server,
)
from libmodbus_py.ports.endpoint import parse
from tests.support.clients import ALL, Connect, World, asking, read
from tests.support.names import NEEDS_IPV6
from tests.support.peers import Answer, UdpPeer, Write, answer, answering, echo
from tests.support.reads import echoes, on_read, reads


@pytest.fixture
def refused_port() -> Iterator[int]:
    """Where nobody listens, and nobody else will: its socket hears another one only."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.connect(sock.getsockname())
        yield int(sock.getsockname()[1])


@NEEDS_IPV6
def test_url_with_an_ipv6_address(connect: Connect) -> None:
    with UdpPeer(on_read, family=socket.AF_INET6) as server, connect(server.url, unit=3) as context:
        assert context.read_holding_registers(5, 1) == [5]
        assert server.requests[0][2:] == bytes.fromhex("0000 0006 03 03 0005 0001")


def damaged(request: bytes) -> list[bytes]:
    answer = echo(request)
    return [
        b"",
        b"\0",
        answer[:-1],
        answer + b"\0",
        answer + answer,
        echo(request, protocol=1),
        echo(request, length=999),
        echo(request, transaction=0x7777),
        bytes(1500),
    ]


def doubled(request: bytes) -> list[bytes]:
    return [echo(request)] * 2


@pytest.mark.parametrize("beside", [damaged, doubled])
def test_datagrams_beside_an_answer_are_dropped(world: World, beside: Answer) -> None:
    peer = world.peer("udp", answering(lambda request: [*beside(request), echo(request)]))
    with world.connect(peer.url, max_in_flight=16) as context:
        assert [read(context, address) for address in range(20)] == list(range(20))
        assert context.execute_many(reads(50)) == echoes(50)


def test_damaged_datagrams_are_no_answer(world: World) -> None:
    peer = world.peer("udp", answering(damaged))
    with world.connect(peer.url, timeout=0.2, max_in_flight=16) as context:
        with (
            world.lasting(0.2),
            pytest.raises(ModbusTimeoutError, match="no complete answer") as caught,
        ):
            context.read_holding_registers(1, 1)
        assert echo(peer.requests[0])[:-1] in caught.value.received
        with world.lasting(0.2), pytest.raises(ModbusTimeoutError):
            context.execute_many(reads(4))


def test_datagram_of_another_host_is_never_seen(connect: Connect) -> None:
    def spoofed(request: bytes, write: Write) -> None:
        client = server.clients[-1]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(echo(request)[:-1] + b"\xff", client)
        write(echo(request))

    with UdpPeer(spoofed) as server, connect(server.url) as context:
        for address in range(10):
            assert context.read_holding_registers(address, 1) == [address]
        assert context.statistics.late_answers == 0


def test_of_many_in_flight_only_those_without_an_answer_time_out(world: World) -> None:
    requests: list[bytes] = []

    def four_at_a_time(request: bytes) -> list[bytes]:
        requests.append(request)
        if len(requests) < 4:
            return []
        answers = [echo(request) for request in reversed(requests) if request[9] not in (5, 30)]
        requests.clear()
        return answers

    peer = world.peer("udp", answering(four_at_a_time))
    with (
        world.connect(peer.url, timeout=60, max_in_flight=16) as context,
        world.lasting(60, more=0.02),
    ):
        outcomes = context.execute_many(reads(40), return_exceptions=True)
    assert [at for at, item in enumerate(outcomes) if isinstance(item, ModbusError)] == [5, 30]
    assert isinstance(outcomes[5], ModbusTimeoutError)
    assert all(outcomes[at] == [at] for at in range(40) if at not in (5, 30))
    assert len(peer.requests) == 40


def test_a_port_without_a_listener_is_a_connection_error_at_once(
    connect: Connect, refused_port: int
) -> None:
    with connect(f"udp://127.0.0.1:{refused_port}", timeout=600) as context:
        for _ in range(3):
            with pytest.raises(ModbusConnectionError) as caught:
                context.read_coils(0, 1)
            assert caught.value.errno == errno.ECONNREFUSED
        outcomes = context.execute_many(reads(800), return_exceptions=True)
        assert {outcome.errno for outcome in outcomes} == {errno.ECONNREFUSED}


def test_a_port_that_is_opened_again_is_used_again(connect: Connect) -> None:
    first = UdpPeer(on_read)
    with connect(first.url) as context:
        with first:
            assert context.read_holding_registers(1, 1) == [1]
        with pytest.raises(ModbusConnectionError):
            context.read_holding_registers(1, 1)
        with UdpPeer(on_read, port=first.port):
            assert context.read_holding_registers(2, 1) == [2]


SCHEMES = pytest.mark.parametrize("scheme", ["udp", "rtu+udp"])


COUNTED = ("late_answers", "invalid", "lost", "connects", "timeouts")


def counted(client: Any) -> dict[str, int]:
    return {name: getattr(client.statistics, name) for name in COUNTED}


@SCHEMES
@ALL
def test_empty_datagrams_before_an_answer_are_ignored(kind: str, scheme: str) -> None:
    def on_request(request: bytes, write: Write) -> None:
        for _ in range(3):
            write(b"")
        write(answer(request, scheme))

    with UdpPeer(on_request, scheme) as peer, asking(kind, peer.url, timeout=30) as client:
        assert [read(client, address) for address in range(20)] == list(range(20))
        assert counted(client) == dict.fromkeys(COUNTED, 0) | {"connects": 1}


@SCHEMES
@ALL
def test_empty_datagrams_to_an_idle_client_change_nothing(kind: str, scheme: str) -> None:
    """Neither its connection nor the rest that a unit without an answer gets."""
    is_silent = False

    def on_request(request: bytes, write: Write) -> None:
        if not is_silent:
            write(answer(request, scheme))

    with UdpPeer(on_request, scheme) as peer, asking(kind, peer.url, timeout=0.1) as client:
        assert read(client, 0) == 0
        is_silent = True
        with pytest.raises(ModbusTimeoutError):
            read(client, 1)
        before = counted(client)
        for _ in range(100):
            peer._socket.sendto(b"", peer.clients[0])
        is_silent = False
        assert read(client.for_unit(1, timeout=30), 2) == 2
        assert counted(client) == before


# A read of one register of unit 1, and its answer 555, by hand: serial line, appendix B.
READ = bytes.fromhex("01 03 0000 0001 840a")
ANSWER = bytes.fromhex("01 03 02 022b f93b")


def test_an_answer_in_two_datagrams_is_one(world: World) -> None:
    """Serial servers send on what has come so far."""
    peer = world.peer("rtu+udp", answering(lambda request: [ANSWER[:3], ANSWER[3:]]))
    with world.connect(peer.url, unit=1, timeout=30) as client:
        assert read(client, 0) == 555
    assert peer.requests == [READ]


def test_a_damaged_answer_ends_the_wait_as_on_a_line(world: World) -> None:
    frame = ANSWER[:-1] + bytes([ANSWER[-1] ^ 1])
    peer = world.peer("rtu+udp", answering(lambda request: [frame]))
    with (
        world.connect(peer.url, unit=1, timeout=30) as client,
        world.lasting(0, more=1),
        pytest.raises(FrameError) as caught,
    ):
        read(client, 0)
    assert caught.value.received == frame


def test_two_servers_do_not_answer_each_other_for_ever() -> None:
    """The answer to a write of one register is that write again."""
    write = bytes.fromhex("01 06 0000 0007 c808")
    server = Server(Device(Mapping(holding_registers=10)))
    with (
        server.background("rtu+udp://127.0.0.1:0") as running,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client,
    ):
        where = ("127.0.0.1", parse(running.urls[0]).port)
        client.sendto(write, where)
        client.settimeout(0.2)
        with contextlib.suppress(TimeoutError):
            for _ in range(100):
                answer = client.recv(600)
                assert answer == write
                client.sendto(answer, where)
        assert server.statistics.reflected == 1
