"""
Clients that begin a frame and do not end it, ask nothing, or do not read: how long each is borne.

Seconds are simulated, and exact but for how often the server looks: every quarter of the shortest
limit, and at least once a second.
"""

import socket

import pytest

from libmodbus_py import Device, Fault, Mapping, Server
from libmodbus_py.server.limits import Limits
from libmodbus_py.server.peer import READ_BYTES
from tests.simulation.lan import Lan, LanClient
from tests.support.attacks import READ_MOST, READ_ONE, adu, connect
from tests.support.lan_server import (
    ANSWER_MOST,
    ANSWER_ONE,
    MOST_ANSWER,
    ONE_ANSWER,
    OVER_TCP,
    ask,
    rtu,
    server_on,
)

KIND = pytest.mark.parametrize("kind", OVER_TCP)

WRITE_MOST = bytes.fromhex("10 0000 007b f6") + bytes(246)

# Every answer is kept back.
LATE = {None: [Fault("delay", seconds=500)]}

# The beginning of a long request, which only silence tells from the whole one that follows.
NEVER_ENDED = bytes.fromhex("11 10 0000 007b f6")


@KIND
@pytest.mark.parametrize("frame_timeout", [0.4, 1000])
def test_single_bytes_do_not_extend_the_time_of_a_frame(lan: Lan, kind: str, frame_timeout):
    with server_on(lan, kind, frame_timeout=frame_timeout) as server:
        slow, silent = server.connect(), server.connect()
        ask(slow)
        start = lan.now
        for byte in adu(WRITE_MOST):
            slow.sendall(bytes([byte]))
            if lan.until(slow.has_input, frame_timeout / 8):
                break
        assert slow.is_closed()
        assert frame_timeout <= lan.now - start <= frame_timeout + min(1, frame_timeout / 4) + 0.01
        assert server.counts(closed_slow=1, connections=1, requests=1)
        ask(silent)  # a client that has begun no frame has no time limit


@KIND
def test_a_frame_that_begins_at_the_end_of_another_has_its_own_time(lan: Lan, kind: str) -> None:
    with server_on(lan, kind, frame_timeout=1) as server:
        slow = server.connect()
        request = adu(READ_ONE)
        slow.sendall(request[:3])
        lan.pass_time(0.99)
        slow.sendall(request[3:] + request[:5])
        second = lan.now
        assert slow.receive(ONE_ANSWER) == adu(ANSWER_ONE)
        lan.pass_time(0.99)  # almost two seconds after the first one began
        slow.sendall(request[5:] + request[:8])
        third = lan.now
        assert slow.receive(ONE_ANSWER) == adu(ANSWER_ONE)
        assert slow.is_closed()
        assert third - second < 1 <= lan.now - third <= 1.26
        assert server.counts(closed_slow=1, connections=0)


def test_the_time_of_a_frame_begins_after_the_previous_answer(lan: Lan) -> None:
    """The rest of it has come, but is not read before the answer has gone."""
    with server_on(lan, faults=LATE, frame_timeout=0.2) as server:
        connection = server.connect()
        connection.sendall(adu(READ_ONE, 1) + adu(READ_ONE, 2)[:5])
        connection.sendall(adu(READ_ONE, 2)[5:])
        both = adu(ANSWER_ONE, 1) + adu(ANSWER_ONE, 2)
        assert connection.receive(len(both)) == both
        assert server.counts(closed_slow=0)


def test_half_a_frame_after_a_late_answer_has_its_own_time(lan: Lan) -> None:
    with server_on(lan, faults=LATE, frame_timeout=20) as server:
        connection = server.connect()
        connection.sendall(adu(READ_ONE, 1) + adu(READ_ONE, 2)[:5])
        assert connection.receive(ONE_ANSWER) == adu(ANSWER_ONE)
        start = lan.now
        assert connection.is_closed()
        assert 20 <= lan.now - start <= 21.01
        assert server.counts(closed_slow=1)


@KIND
@pytest.mark.parametrize("idle_timeout", [0.5, 3600])
def test_idle_clients_are_closed(lan: Lan, kind: str, idle_timeout: float) -> None:
    look = min(1, idle_timeout / 4)
    with server_on(lan, kind, idle_timeout=idle_timeout, frame_timeout=4 * look) as server:
        stranger, idle, busy = (server.connect() for _ in range(3))
        lan.pass_time(idle_timeout / 2)
        ask(idle)
        start = lan.now
        ends: dict[LanClient, float] = {}
        while len(ends) < 2:
            ask(busy)
            lan.pass_time(idle_timeout / 20)
            for peer in (stranger, idle):
                if peer.has_input():
                    ends.setdefault(peer, lan.now - start)
        late = look + idle_timeout / 20 + 0.01
        assert idle_timeout / 2 - 0.01 <= ends[stranger] <= idle_timeout / 2 + late
        assert idle_timeout - 0.01 <= ends[idle] <= idle_timeout + late
        assert stranger.is_closed()
        assert idle.is_closed()
        ask(busy)
        assert server.counts(connections=1, closed_idle=2)


def test_idle_clients_stay_connected_without_a_limit(lan: Lan) -> None:
    with server_on(lan, idle_timeout=None) as server:
        idle, stranger = server.connect(), server.connect()
        ask(idle)
        lan.pass_time(2 * 3600)
        ask(idle)
        ask(stranger)
        assert server.counts(connections=2, closed_idle=0, closed_slow=0)


def test_clients_with_frames_that_end_with_silence_are_not_idle(lan: Lan) -> None:
    with server_on(lan, "plain", "rtu+tcp", idle_timeout=0.8) as server:
        sly, idle = server.connect(), server.connect()
        answer = rtu(ANSWER_ONE)
        for _ in range(12):
            sly.sendall(NEVER_ENDED + rtu(READ_ONE))
            assert sly.receive(len(answer)) == answer
            lan.pass_time(0.1)
        assert server.counts(connections=1, closed_idle=1, requests=12)
        assert idle.is_closed()


@pytest.mark.parametrize("data", [b"", adu(READ_ONE)[:5]], ids=["idle", "slow"])
def test_the_system_closes_unreachable_clients_in_time(data: bytes) -> None:
    """On the real system, unlike the other tests of this file."""
    limits = Limits(frame_timeout=0.1, idle_timeout=0.2)
    server = Server({17: Device(Mapping(holding_registers=1))}, limits=limits)
    with server.background("tcp://127.0.0.1:0") as running, connect(running.urls[0]) as client:
        client.sendall(data)
        assert client.recv(1) == b""
    assert (server.statistics.closed_slow, server.statistics.closed_idle) == (
        (1, 0) if data else (0, 1)
    )


# More answers than the network in memory carries at once, and the server keeps.
MANY = 1200

# The most that one read of the server takes.
ONE_READ = READ_BYTES // len(adu(READ_MOST))


def pipelined(count: int) -> bytes:
    return b"".join(adu(READ_MOST, number & 0xFFFF) for number in range(count))


def answers(count: int) -> bytes:
    return b"".join(adu(ANSWER_MOST, number & 0xFFFF) for number in range(count))


@KIND
@pytest.mark.parametrize("max_unsent", [0, 65_536])
def test_a_client_that_reads_slowly_gets_every_answer(lan: Lan, kind: str, max_unsent: int) -> None:
    with server_on(lan, kind, max_unsent=max_unsent, frame_timeout=10) as server:
        deaf, other = server.connect(), server.connect()
        deaf.sendall(pipelined(MANY))
        assert server.counts(paused=1)
        before = server.statistics.requests
        # What is on its way to the client, the limit, and one read more than that.
        most = deaf.end.capacity + max_unsent + ONE_READ * MOST_ANSWER
        assert max_unsent < before * MOST_ANSWER <= most
        lan.pass_time(3000)
        for _ in range(20):
            ask(other)
        assert server.counts(requests=before + 20, connections=2, closed_slow=0, paused=1)
        assert deaf.receive(MANY * MOST_ANSWER) == answers(MANY)
        ask(deaf)
        assert server.counts(connections=2, requests=MANY + 21)


@KIND
def test_a_client_that_closed_its_sending_side_gets_every_answer(lan: Lan, kind: str) -> None:
    with server_on(lan, kind) as server:
        deaf = server.connect()
        deaf.sendall(pipelined(MANY))
        deaf.shutdown(socket.SHUT_WR)
        assert server.counts(paused=1)
        assert deaf.receive(MANY * MOST_ANSWER) == answers(MANY)
        assert deaf.is_closed()
        assert server.counts(connections=0)


@KIND
def test_the_last_answers_must_be_read_within_the_frame_timeout(lan: Lan, kind: str) -> None:
    """Too few for the limit, but more than the system takes; then nonsense."""
    with server_on(lan, kind, max_unsent=2**30, frame_timeout=20) as server:
        deaf = server.connect()
        deaf.sendall(pipelined(MANY) + bytes(8))
        start = lan.now
        assert lan.until(lambda: server.statistics.connections == 0)
        assert 20 <= lan.now - start <= 21.01
        assert server.counts(closed_out_of_step=1, closed_slow=1, requests=MANY)
