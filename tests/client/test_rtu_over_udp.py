"""
RTU frames in datagrams: both clients, the server, and what a datagram may not be.
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Iterator

import pytest

from libmodbus_py import (
    Context,
    Device,
    FrameError,
    InvalidResponse,
    Mapping,
    ModbusTimeoutError,
    Server,
    UdpContext,
)
from libmodbus_py.ports.endpoint import parse
from tests.support.clients import EVERYWHERE, World, read
from tests.support.peers import Write, answering, until

# A read of one register of unit 1, and its answer 555, by hand: serial line, appendix B.
READ = bytes.fromhex("01 03 0000 0001 840a")
ANSWER = bytes.fromhex("01 03 02 022b f93b")


@pytest.fixture
def device() -> Device:
    made = Device(Mapping(10, 10, 10, 10))
    made.mapping.holding_registers[0] = 555
    return made


@contextlib.contextmanager
def bound() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.bind(("127.0.0.1", 0))
        made.settimeout(5)
        yield made


def test_its_url() -> None:
    endpoint = parse("rtu+udp://192.0.2.1")
    assert (endpoint.framing, endpoint.transport, endpoint.port) == ("rtu", "udp", 502)
    assert str(endpoint) == "rtu+udp://192.0.2.1:502"
    with Context.from_url("rtu+udp://127.0.0.1:1502") as context:
        assert type(context) is UdpContext
    with pytest.raises(ValueError, match="max_in_flight"):
        Context.from_url("rtu+udp://192.0.2.1?max_in_flight=4")


@EVERYWHERE
def test_the_bytes_are_those_of_a_line(world: World) -> None:
    peer = world.peer("rtu+udp", answering(lambda request: [ANSWER]))
    with world.connect(peer.url, unit=1, timeout=30) as client:
        assert read(client, 0) == 555
    assert peer.requests == [READ]


def test_a_late_answer_is_not_that_to_the_next_request(world: World) -> None:
    late = bytes.fromhex("01 03 02 0001 7984")

    def on_request(request: bytes, write: Write) -> None:
        if len(peer.requests) == 2:
            write(late, after=0.4)
        else:
            write(ANSWER)

    peer = world.peer("rtu+udp", on_request)
    with world.connect(peer.url, unit=1, timeout=0.3) as client:
        assert read(client, 0) == 555
        with world.lasting(0.3), pytest.raises(ModbusTimeoutError):
            read(client, 0)
        # A time-out of silence behind the late one.
        with world.lasting(0.1 + 0.3, more=0.005):
            assert read(client, 0) == 555
        assert client.late_answers == 1
    assert peer.requests == [READ] * 3


@EVERYWHERE
def test_an_answer_in_two_datagrams_is_one(world: World) -> None:
    """Serial servers send on what has come so far."""
    peer = world.peer("rtu+udp", answering(lambda request: [ANSWER[:3], ANSWER[3:]]))
    with world.connect(peer.url, unit=1, timeout=30) as client:
        assert read(client, 0) == 555


def test_a_damaged_answer_ends_the_wait_as_on_a_line(world: World) -> None:
    damaged = ANSWER[:-1] + bytes([ANSWER[-1] ^ 1])
    peer = world.peer("rtu+udp", answering(lambda request: [damaged]))
    with (
        world.connect(peer.url, unit=1, timeout=30) as client,
        world.lasting(0, more=1),
        pytest.raises(FrameError) as caught,
    ):
        read(client, 0)
    assert caught.value.received == damaged


def test_another_units_answer_is_none(world: World) -> None:
    wrong = bytes.fromhex("02 03 02 022b bd3b")
    peer = world.peer("rtu+udp", answering(lambda request: [wrong]))
    with (
        world.connect(peer.url, unit=1, timeout=0.2) as client,
        world.lasting(0.2),
        pytest.raises(InvalidResponse, match="unit 2 answered"),
    ):
        read(client, 0)


# --- the server -------------------------------------------------------------------------------


def test_a_datagram_is_answered_by_one(device: Device) -> None:
    with Server({1: device}).background("rtu+udp://127.0.0.1:0") as running, bound() as client:
        where = ("127.0.0.1", parse(running.urls[0]).port)
        client.sendto(READ, where)
        assert client.recv(600) == ANSWER
        # Neither damage, nor half a frame, nor another unit; and nothing of it is left.
        for silent in (READ[:-1] + b"\0", READ[:5], b"\x07" + READ[1:], b"", bytes(600)):
            client.sendto(silent, where)
        client.sendto(READ[5:], where)
        client.sendto(READ, where)
        assert client.recv(600) == ANSWER
        client.settimeout(0.1)
        with pytest.raises(TimeoutError):
            client.recv(600)


def test_beginnings_of_frames_are_not_waited_for(device: Device) -> None:
    """Whoever sends them could keep a server from answering others."""
    with Server({1: device}).background("rtu+udp://127.0.0.1:0") as running, bound() as client:
        where = ("127.0.0.1", parse(running.urls[0]).port)
        for number in range(1200):
            client.sendto(READ[:5], where)
            if number % 50 == 0:  # so that none is lost in between
                client.sendto(READ, where)
                assert client.recv(600) == ANSWER
        time.sleep(0.1)
        client.sendto(READ, where)
        assert client.recv(600) == ANSWER


def test_a_broadcast_reaches_all_and_nobody_answers(device: Device) -> None:
    second = Device(Mapping(10, 10, 10, 10))
    server = Server({1: device, 2: second})
    with server.background("rtu+udp://127.0.0.1:0") as running:
        with Context.from_url(running.urls[0], unit=0) as context:
            context.write_register(3, 9)
        until(lambda: second.mapping.holding_registers[3] == 9)
        assert device.mapping.holding_registers[3] == 9


def test_two_servers_do_not_answer_each_other_for_ever(device: Device) -> None:
    """The answer to a write of one register is that write again."""
    write = bytes.fromhex("01 06 0000 0007 c808")
    server = Server({1: device})
    with server.background("rtu+udp://127.0.0.1:0") as running, bound() as client:
        where = ("127.0.0.1", parse(running.urls[0]).port)
        client.sendto(write, where)
        client.settimeout(0.2)
        with contextlib.suppress(TimeoutError):
            for _ in range(100):
                answer = client.recv(600)
                assert answer == write
                client.sendto(answer, where)
        assert server.statistics.reflected == 1
