"""
What clients may cost a server, limit by limit, and what it counts of them.
"""

from __future__ import annotations

import asyncio
import dataclasses
import gc
import math
import os
import select
import socket
import struct
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Access, Device, Fault, Mapping, Server, framing
from libmodbus_py.server.by_frame import ByFrame
from libmodbus_py.server.faults_due import Faults
from libmodbus_py.server.limits import Allowance, Limits, ServerStatistics
from libmodbus_py.server.peers import Peer, Peers
from libmodbus_py.server.units import TcpUnits, Units
from libmodbus_py.testing.wires import SerialWire
from tests.support.attacks import (
    PATIENCE,
    READ_MOST,
    READ_ONE,
    ServerProcess,
    adu,
    connect,
    descriptor_limit,
    receive,
)

ANSWER_ONE = bytes.fromhex("03 02 0000")
ONE_ANSWER = len(adu(ANSWER_ONE))
ANSWER_MOST = bytes([3, 250]) + bytes(250)
MOST_ANSWER = len(adu(ANSWER_MOST))
WRITE_MOST = bytes.fromhex("10 0000 007b f6") + bytes(246)
ILLEGAL_COUNT = bytes.fromhex("03 0000 0000")

# What timers may be early by.
CLOCK = 0.01

# Most of the server's ways to answer: in C by the chunk, through hooks, with faults.
KINDS = ["plain", "hooked", "faulty"]

# Happens to nobody here, but makes every answer go the way of faults.
NEVER = Fault("no_answer", function=100)


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


class Served:
    """A server in this process, and how to reach it."""

    def __init__(self, server: Server, port: int) -> None:
        self.statistics = server.statistics
        self.port = port

    def connect(self) -> socket.socket:
        return connect(self.port)

    def has(self, **expected: int) -> bool:
        """Whether the statistics become that, soon."""
        return self._comes(lambda: all(self._now(name) == expected[name] for name in expected))

    def has_at_least(self, **expected: int) -> bool:
        return self._comes(lambda: all(self._now(name) >= expected[name] for name in expected))

    def _now(self, name: str) -> int:
        return int(getattr(self.statistics, name))

    def _comes(self, is_so: Callable[[], bool]) -> bool:
        deadline = time.monotonic() + PATIENCE
        while not is_so():
            if time.monotonic() > deadline:
                return False
            time.sleep(0.005)
        return True


@contextmanager
def served(kind: str = "plain", scheme: str = "tcp", **limits: Any) -> Iterator[Served]:
    mapping = Mapping(holding_registers=125)
    device = Device(mapping, before_read=(lambda access: None) if kind == "hooked" else None)
    faults = {None: [NEVER]} if kind == "faulty" else None
    server = Server({17: device}, faults, Limits(**limits))
    with server.background(f"{scheme}://127.0.0.1:0") as running:
        yield Served(server, int(running.urls[0].rpartition(":")[2]))


def ask(connection: socket.socket, transaction: int = 1) -> None:
    """One request, and its answer."""
    connection.sendall(adu(READ_ONE, transaction))
    assert receive(connection, ONE_ANSWER) == adu(ANSWER_ONE, transaction)


def is_closed(connection: socket.socket) -> bool:
    """Whether nothing comes any more, for the server has closed."""
    try:
        return connection.recv(1) == b""
    except ConnectionResetError:
        return True


# --- arguments ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "error"),
    [
        ("max_connections", 0, ValueError),
        ("max_connections", -1, ValueError),
        ("max_connections", 1_000_001, ValueError),
        ("max_connections", 1.5, TypeError),
        ("max_connections", True, TypeError),
        ("max_connections", "8", TypeError),
        ("connections_per_address", 0, ValueError),
        ("connections_per_address", 1_000_001, ValueError),
        ("connections_per_address", 2.0, TypeError),
        ("connections_per_address", True, TypeError),
        ("when_full", "drop", ValueError),
        ("when_full", None, ValueError),
        ("frame_timeout", 0, ValueError),
        ("frame_timeout", -1, ValueError),
        ("frame_timeout", 86_401, ValueError),
        ("frame_timeout", math.inf, ValueError),
        ("frame_timeout", math.nan, ValueError),
        ("frame_timeout", None, TypeError),
        ("frame_timeout", "5", TypeError),
        ("frame_timeout", True, TypeError),
        ("idle_timeout", 0, ValueError),
        ("idle_timeout", 86_401, ValueError),
        ("idle_timeout", math.nan, ValueError),
        ("idle_timeout", "5", TypeError),
        ("max_unsent", -1, ValueError),
        ("max_unsent", 2**30 + 1, ValueError),
        ("max_unsent", None, TypeError),
        ("max_unsent", 1.0, TypeError),
        ("allow", "192.0.2.0/24", TypeError),
        ("allow", ["192.0.2.0/33"], ValueError),
        ("allow", ["plant.example"], ValueError),
        ("allow", [""], ValueError),
        ("requests_per_second", 0, ValueError),
        ("requests_per_second", 0.0001, ValueError),
        ("requests_per_second", 1_000_001, ValueError),
        ("requests_per_second", math.nan, ValueError),
        ("requests_per_second", "5", TypeError),
        ("requests_per_second", True, TypeError),
    ],
)
def test_a_limit_that_cannot_be_is_named(name: str, value: object, error: type[Exception]) -> None:
    with pytest.raises(error, match=name):
        Limits(**{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("networks", [5, [None], [object()], None])
def test_networks_that_are_none_are_named(networks: object) -> None:
    with pytest.raises((TypeError, ValueError), match="allow"):
        Limits(allow=networks)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "limits",
    [
        {"max_connections": 1},
        {"max_connections": 1_000_000},
        {"connections_per_address": 1},
        {"connections_per_address": 1_000_000},
        {"frame_timeout": 0.001, "idle_timeout": 86_400},
        {"idle_timeout": None},
        {"max_unsent": 0},
        {"max_unsent": 2**30},
        {"requests_per_second": 0.001},
        {"requests_per_second": 1_000_000},
        {"allow": iter(["::1", "10.0.0.0/8", "192.0.2.7/24"])},
    ],
)
def test_limits_reach_to_their_ends(limits: dict[str, Any]) -> None:
    Limits(**limits)


@pytest.mark.parametrize("limits", [5, {}, {"max_connections": 2}, Limits])
def test_server_takes_only_limits(limits: object) -> None:
    with pytest.raises(TypeError, match="limits"):
        Server({}, limits=limits)  # type: ignore[arg-type]


@pytest.mark.parametrize("policy", ["ignore", "", None, 1, {}, Device(Mapping())])
def test_unknown_unit_is_a_policy(policy: object) -> None:
    with pytest.raises((TypeError, ValueError), match="unknown_unit"):
        Server({}, unknown_unit=policy)  # type: ignore[arg-type]


def test_as_many_connections_as_descriptors_leave() -> None:
    with descriptor_limit(200):
        assert 1 <= Limits().connections() < 200
    with descriptor_limit(20):
        assert Limits().connections() == 1
    assert Limits(max_connections=7).connections() == 7


# --- max_connections ---------------------------------------------------------------------


def test_first_go_those_that_never_asked_then_the_longest_idle(kind: str) -> None:
    with served(kind, max_connections=3) as server, ExitStack() as stack:
        first, second, stranger = (stack.enter_context(server.connect()) for _ in range(3))
        ask(first)
        ask(second)
        time.sleep(0.1)
        ask(first)  # now the second one is the longest idle

        third = stack.enter_context(server.connect())
        ask(third)
        assert is_closed(stranger)
        ask(stack.enter_context(server.connect()))
        assert is_closed(second)
        ask(first)
        ask(third)
        assert server.has(connections=3, accepted=5, closed_for_others=2, refused_full=0)


def test_a_full_server_can_refuse(kind: str) -> None:
    with (
        served(kind, max_connections=2, when_full="refuse") as server,
        server.connect() as first,
        server.connect() as second,
    ):
        ask(first)
        ask(second)
        with server.connect() as refused:
            assert is_closed(refused)
        ask(first)
        ask(second)
        assert server.has(connections=2, accepted=2, closed_for_others=0, refused_full=1)
        first.close()
        assert server.has(connections=1)
        with server.connect() as newcomer:
            ask(newcomer)


def test_endpoints_share_their_connections() -> None:
    server = Server(Device(Mapping()), limits=Limits(max_connections=1))
    with server.background("tcp://127.0.0.1:0", "rtu+tcp://127.0.0.1:0") as running:
        ports = [int(url.rpartition(":")[2]) for url in running.urls]
        with connect(ports[0]) as first, connect(ports[1]):
            assert is_closed(first)
    assert server.statistics.closed_for_others == 1


def test_connections_left_at_the_end_are_closed() -> None:
    with ExitStack() as stack:
        with served() as server:
            connection = stack.enter_context(server.connect())
            ask(connection)
        assert is_closed(connection)
        assert server.statistics.connections == 0


# --- connections_per_address -------------------------------------------------------------


@pytest.mark.parametrize(("most", "of_one"), [(1000, 100), (200, 20), (80, 8), (5, 8), (1, 8)])
def test_an_address_may_have_a_tenth_of_all_but_eight_at_least(most: int, of_one: int) -> None:
    assert Limits(max_connections=most).connections_of_address() == of_one
    assert Limits(max_connections=most, connections_per_address=3).connections_of_address() == 3


def test_an_address_with_too_many_makes_room_among_its_own(kind: str) -> None:
    with (
        served(kind, max_connections=6, connections_per_address=3) as server,
        ExitStack() as stack,
    ):
        others = [stack.enter_context(connect_from("127.0.0.2", server.port)) for _ in range(3)]
        ask(others[0])
        assert server.has(connections=3)
        first, second, stranger = (stack.enter_context(server.connect()) for _ in range(3))
        ask(first)
        ask(second)
        for number in range(20):
            newcomer = stack.enter_context(server.connect())
            assert is_closed(stranger)
            stranger = newcomer
            assert server.has(connections=6, closed_for_others=1 + number)
        ask(stranger)
        ask(stack.enter_context(server.connect()))
        assert is_closed(first)
        for other in others:  # two of them are strangers, who would have gone first
            ask(other)
        assert server.has(connections=6, refused_full=0, refused_address=0)


def test_an_address_with_too_many_can_be_refused(kind: str) -> None:
    with (
        served(kind, connections_per_address=2, when_full="refuse") as server,
        server.connect() as first,
        server.connect() as second,
    ):
        ask(first)
        ask(second)
        for _ in range(3):
            with server.connect() as refused:
                assert is_closed(refused)
        with connect_from("127.0.0.2", server.port) as other:
            ask(other)
        ask(first)
        assert server.has(connections=2, refused_address=3, refused_full=0, closed_for_others=0)
        second.close()
        assert server.has(connections=1)
        with server.connect() as newcomer:
            ask(newcomer)


def test_ipv4_within_ipv6_is_the_same_address() -> None:
    """As a listener for both families would say it."""

    async def refused(*hosts: str) -> int:
        statistics = ServerStatistics()
        peers = Peers(Limits(connections_per_address=1, when_full="refuse"), statistics)
        device = Units(Device(Mapping()), Faults({}))
        with ExitStack() as stack:
            stack.callback(peers.close)
            for host in hosts:
                ours, theirs = socket.socketpair()
                stack.enter_context(ours)
                peers.admit(
                    theirs,
                    (host, 1),
                    lambda peer: ByFrame(
                        TcpUnits(device), "tcp", peer.address, statistics, peer.write
                    ),
                )
            return statistics.refused_address

    assert asyncio.run(refused("192.0.2.7", "::ffff:192.0.2.7", "::ffff:192.0.2.7")) == 2
    assert asyncio.run(refused("192.0.2.7", "::ffff:192.0.2.8", "::192.0.2.7")) == 0


# --- frame_timeout -----------------------------------------------------------------------


def trickle(connection: socket.socket, data: bytes, gap: float) -> float:
    """Send byte by byte until the server closes; give the seconds that took."""
    start = time.monotonic()
    connection.settimeout(gap)
    for byte in data:
        try:
            connection.sendall(bytes([byte]))
            if connection.recv(1) == b"":
                break
        except TimeoutError:
            continue
        except OSError:
            break
    else:
        pytest.fail("never closed")
    return time.monotonic() - start


def test_a_trickle_does_not_extend_the_time_of_a_frame(kind: str) -> None:
    with (
        served(kind, frame_timeout=0.4) as server,
        server.connect() as slow,
        server.connect() as silent,
    ):
        ask(slow)
        assert trickle(slow, adu(WRITE_MOST), gap=0.05) >= 0.4
        assert server.has(closed_slow=1, connections=1, requests=1)
        ask(silent)  # who begins nothing has all the time


def test_a_frame_that_begins_where_another_ends_has_its_own_time(kind: str) -> None:
    with served(kind, frame_timeout=1) as server, server.connect() as slow:
        request = adu(READ_ONE)
        slow.sendall(request[:3])
        time.sleep(0.6)
        slow.sendall(request[3:] + request[:5])
        second = time.monotonic()
        assert receive(slow, ONE_ANSWER) == adu(ANSWER_ONE)
        time.sleep(0.6)  # more than a second after the first one began
        slow.sendall(request[5:] + request[:8])
        assert receive(slow, ONE_ANSWER) == adu(ANSWER_ONE)
        assert is_closed(slow)
        assert time.monotonic() - second >= 1.6
        assert server.has(closed_slow=1, connections=0)


def test_the_time_of_a_frame_is_not_that_of_the_answer_before() -> None:
    """The rest of it has come, but is not read before the answer has gone."""
    faults = {None: [Fault("delay", seconds=0.5)]}
    server = Server(Device(Mapping(holding_registers=1)), faults, Limits(frame_timeout=0.2))
    with (
        server.background("tcp://127.0.0.1:0") as running,
        connect(int(running.urls[0].rpartition(":")[2])) as connection,
    ):
        connection.sendall(adu(READ_ONE, 1) + adu(READ_ONE, 2)[:5])
        connection.sendall(adu(READ_ONE, 2)[5:])
        expected = adu(ANSWER_ONE, 1) + adu(ANSWER_ONE, 2)
        assert receive(connection, len(expected)) == expected
    assert server.statistics.closed_slow == 0


# --- idle_timeout ------------------------------------------------------------------------


def test_who_asks_nothing_is_closed(kind: str) -> None:
    with (
        served(kind, idle_timeout=0.5, frame_timeout=0.4) as server,
        server.connect() as stranger,
        server.connect() as known,
        server.connect() as busy,
    ):
        ask(known)
        start = time.monotonic()
        while server.statistics.closed_idle < 2:
            ask(busy)
            time.sleep(0.02)
            assert time.monotonic() - start < PATIENCE
        assert time.monotonic() - start >= 0.4
        assert is_closed(stranger)
        assert is_closed(known)
        ask(busy)
        assert server.has(connections=1, closed_idle=2)


# --- max_unsent --------------------------------------------------------------------------


def deaf(server: Served) -> socket.socket:
    """A connection that takes little unless it is read."""
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection.settimeout(PATIENCE)
    connection.connect(("127.0.0.1", server.port))
    return connection


@contextmanager
def sending(connection: socket.socket, data: bytes, *, then_end: bool = False) -> Iterator[None]:
    """Meanwhile send in a thread; `then_end`: and say that nothing more comes."""

    def send() -> None:
        connection.sendall(data)
        if then_end:
            connection.shutdown(socket.SHUT_WR)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        thread.join()


def most_in_the_system() -> int:
    """Bytes that the system may keep for a connection on its way out."""
    return int(Path("/proc/sys/net/ipv4/tcp_wmem").read_text().split()[2])


# Answers that no system buffers.
MANY = 2 * most_in_the_system() // MOST_ANSWER


def pipelined(count: int) -> bytes:
    return b"".join(adu(READ_MOST, number & 0xFFFF) for number in range(count))


def receive_all(connection: socket.socket, count: int) -> None:
    for number in range(count):
        assert receive(connection, MOST_ANSWER) == adu(ANSWER_MOST, number & 0xFFFF)


@pytest.mark.parametrize("max_unsent", [0, 65_536])
def test_who_never_reads_is_not_read_and_later_gets_every_answer(
    kind: str, max_unsent: int
) -> None:
    with (
        served(kind, max_unsent=max_unsent) as server,
        deaf(server) as connection,
        server.connect() as other,
        sending(connection, pipelined(MANY)),
    ):
        assert server.has(paused=1)
        time.sleep(0.2)  # the system takes some more
        before = server.statistics.requests
        for _ in range(20):
            ask(other)
            time.sleep(0.005)
        one_read = 1024 // len(adu(READ_MOST))
        assert before + 20 <= server.statistics.requests <= before + 20 + one_read
        # One read more than the limit, and what the system took.
        most = max_unsent + one_read * MOST_ANSWER + most_in_the_system()
        assert before * MOST_ANSWER <= most
        receive_all(connection, MANY)
        ask(connection)
        assert server.has(connections=2, requests=MANY + 21)


def test_who_says_that_nothing_more_comes_still_gets_every_answer(kind: str) -> None:
    with served(kind) as server, deaf(server) as connection:
        with sending(connection, pipelined(MANY), then_end=True):
            assert server.has(paused=1)
            receive_all(connection, MANY)
        assert is_closed(connection)
        assert server.has(connections=0)


def test_the_last_answers_must_be_taken_within_the_time_of_a_frame(kind: str) -> None:
    """Too few for the limit, but more than the system takes; then nonsense."""
    with (
        served(kind, max_unsent=2**30, frame_timeout=0.2) as server,
        deaf(server) as connection,
        sending(connection, pipelined(MANY) + bytes(8)),
    ):
        assert server.has(closed_out_of_step=1, closed_slow=1, connections=0)
        assert server.statistics.requests == MANY


# --- allow -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("allow", "host", "allowed"),
    [
        ([], "203.0.113.9", True),
        (["192.0.2.0/24"], "192.0.2.255", True),
        (["192.0.2.0/24"], "192.0.3.0", False),
        (["192.0.2.7/24"], "192.0.2.1", True),
        (["192.0.2.7"], "192.0.2.7", True),
        (["192.0.2.7"], "192.0.2.8", False),
        (["192.0.2.7", "2001:db8::/32"], "2001:db8:ffff::1", True),
        (["192.0.2.7", "2001:db8::/32"], "2001:db9::1", False),
        (["192.0.2.0/24"], "::ffff:192.0.2.7", True),
        (["192.0.2.0/24"], "::ffff:192.0.3.7", False),
        (["192.0.2.0/24"], "::1", False),
        (["0.0.0.0/0"], "::1", False),
        (["fe80::/10"], "fe80::1%eth0", True),
        (["::1"], "127.0.0.1", False),
    ],
)
def test_networks(allow: list[str], host: str, allowed: bool) -> None:
    assert Limits(allow=allow).allows(host) is allowed


def test_a_copy_of_limits_allows_no_more() -> None:
    limits = dataclasses.replace(Limits(allow=iter(["192.0.2.7"])), max_connections=5)
    assert limits.allows("192.0.2.7")
    assert not limits.allows("192.0.2.8")


def test_hosts_outside_are_closed_at_once(kind: str) -> None:
    with served(kind, allow=["127.0.0.2", "127.1.0.0/16"]) as server:
        for source in ("127.0.0.1", "127.0.0.3"):
            with connect_from(source, server.port) as outside:
                assert is_closed(outside)
        for source in ("127.0.0.2", "127.1.2.3"):
            with connect_from(source, server.port) as inside:
                ask(inside)
        assert server.has(connections=0, accepted=2, disallowed=2)


def connect_from(source: str, port: int) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), PATIENCE, (source, 0))


@pytest.mark.parametrize(("allow", "allowed"), [("::1", True), ("2001:db8::/32", False)])
def test_hosts_of_ipv6(allow: str, allowed: bool) -> None:
    server = Server(Device(Mapping(holding_registers=1)), limits=Limits(allow=[allow]))
    with (
        server.background("tcp://[::1]:0") as running,
        connect(int(running.urls[0].rpartition(":")[2]), "::1") as connection,
    ):
        if allowed:
            ask(connection)
        else:
            assert is_closed(connection)
    assert server.statistics.disallowed == (not allowed)


# --- requests_per_second -----------------------------------------------------------------


def test_an_allowance_is_of_one_second_and_grows_with_time() -> None:
    allowance = Allowance(10, now=100)
    allowance.spend(10)
    assert allowance.wait(100) == 0
    allowance.spend(5)
    assert allowance.wait(100) == pytest.approx(0.5)
    assert allowance.wait(100.2) == pytest.approx(0.3)
    assert allowance.wait(100.5) == 0
    allowance.spend(1)
    assert allowance.wait(100.5) == pytest.approx(0.1)
    allowance.wait(1000)
    allowance.spend(11)
    assert allowance.wait(1000) == pytest.approx(0.1)


def test_a_slow_allowance_begins_with_one_request() -> None:
    allowance = Allowance(0.1, now=0)
    allowance.spend(1)
    assert allowance.wait(0) == 0
    allowance.spend(1)
    assert allowance.wait(0) == pytest.approx(10)


def test_one_by_one_requests_take_their_time(kind: str) -> None:
    with (
        served(kind, requests_per_second=20) as server,
        server.connect() as eager,
        connect_from("127.0.0.2", server.port) as other,
    ):
        start = time.monotonic()
        for number in range(32):
            ask(eager, number)
        # 20 are free, and the one that overdraws is answered.
        assert time.monotonic() - start >= (32 - 20 - 1) / 20 - CLOCK
        ask(other)
        assert server.statistics.throttled >= 10
        assert server.has(requests=33, connections=2)


@pytest.mark.alone
def test_requests_sent_at_once_wait_and_none_is_lost(kind: str) -> None:
    """For longer than a frame may take, and one of them is cut where reading stopped."""
    count = 300
    with (
        served(kind, requests_per_second=100, frame_timeout=0.2) as server,
        server.connect() as eager,
        connect_from("127.0.0.2", server.port) as other,
    ):
        start = time.monotonic()
        eager.sendall(b"".join(adu(READ_ONE, number) for number in range(count)))
        assert server.has_at_least(throttled=1)
        for number in range(50):
            ask(other, number)
        expected = b"".join(adu(ANSWER_ONE, number) for number in range(count))
        assert receive(eager, len(expected)) == expected
        at_once = 1024 // len(adu(READ_ONE))
        assert time.monotonic() - start >= (count - 100 - at_once) / 100 - CLOCK
        assert server.has(requests=count + 50, connections=2, closed_slow=0)


def peers_in_memory() -> int:
    gc.collect()
    return sum(isinstance(each, Peer) for each in gc.get_objects())


def test_a_connection_lost_while_it_waits_leaves_nothing(kind: str) -> None:
    before = peers_in_memory()  # errors that tests keep may hold some
    with served(kind, requests_per_second=0.001) as server:
        for number in range(20):
            with connect_from(f"127.3.0.{1 + number}", server.port) as eager:
                eager.sendall(adu(READ_ONE) * 2)
                assert receive(eager, 2 * ONE_ANSWER) == adu(ANSWER_ONE) * 2
                eager.sendall(adu(READ_ONE))
                assert server.has(connections=1, throttled=1 + number)
                # Closing resets it.
                eager.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            assert server.has(connections=0)
        assert peers_in_memory() <= before


def rtu(pdu: bytes, unit: int = 17) -> bytes:
    return framing.RtuFramer("server").encode(framing.Frame(unit, pdu))


# The beginning of a long request, which only silence tells from the whole one that follows.
NEVER_ENDED = bytes.fromhex("11 10 0000 007b f6")


def test_connections_of_an_address_share_what_it_may_ask(kind: str) -> None:
    with served(kind, requests_per_second=10) as server, ExitStack() as stack:
        start = time.monotonic()
        eager = [stack.enter_context(server.connect()) for _ in range(8)]
        answered = 0
        while time.monotonic() - start < 1:
            for client in eager:
                client.sendall(adu(READ_ONE))
            time.sleep(0.05)
        answered = server.statistics.requests
        # Ten are free, and one read of each connection may overdraw, by one request each time.
        assert 10 <= answered <= 10 + 8 * 4 + 10 * (time.monotonic() - start)
        with connect_from("127.0.0.2", server.port) as other:
            ask(other)
        assert server.statistics.throttled >= 8


def test_a_new_connection_brings_nothing_new_to_ask(kind: str) -> None:
    with served(kind, requests_per_second=5) as server:
        start = time.monotonic()
        for _ in range(40):
            with server.connect() as client:
                client.sendall(adu(READ_ONE))
                time.sleep(0.02)
        # Five are free, and a read may overdraw.
        assert server.statistics.requests <= 5 + 1 + 5 * (time.monotonic() - start)
        assert server.has(connections=0)


# A header whose length cannot be: the connection is closed.
OUT_OF_STEP = bytes.fromhex("0001 0000 ffff 11 03")


def test_requests_count_though_what_follows_ends_the_connection(kind: str) -> None:
    with served(kind, requests_per_second=5) as server:
        start = time.monotonic()
        for _ in range(20):
            with server.connect() as client:
                client.sendall(2 * adu(READ_ONE) + OUT_OF_STEP)
                time.sleep(0.02)
        # Five are free, and a read may overdraw.
        assert server.statistics.requests <= 5 + 2 + 5 * (time.monotonic() - start)
        assert server.has(connections=0)


def test_to_be_refused_brings_nothing_new_to_ask_either() -> None:
    with served("plain", requests_per_second=0.5, max_connections=1, when_full="refuse") as server:
        with server.connect() as eager:
            ask(eager)
            ask(eager)
        assert server.has(connections=0)
        with connect_from("127.0.0.2", server.port) as other:
            ask(other)
            with server.connect() as refused:
                assert is_closed(refused)
        assert server.has(connections=0, refused_full=1)
        before = server.statistics.throttled
        with server.connect() as again:
            again.sendall(adu(READ_ONE))
            assert server.has_at_least(throttled=before + 1)


def test_all_connections_that_wait_are_answered_in_the_end(kind: str) -> None:
    with served(kind, requests_per_second=40) as server, ExitStack() as stack:
        eager = [stack.enter_context(server.connect()) for _ in range(8)]
        for _ in range(10):
            for client in eager:
                client.sendall(adu(READ_ONE))
        for client in eager:
            assert receive(client, 10 * ONE_ANSWER) == 10 * adu(ANSWER_ONE)
        assert server.has(requests=80, connections=8)


def test_a_connection_that_waits_and_is_closed_does_not_keep_the_others(kind: str) -> None:
    with served(kind, requests_per_second=2) as server, ExitStack() as stack:
        first, second = (stack.enter_context(server.connect()) for _ in range(2))
        for _ in range(4):
            ask(first)
        first.sendall(adu(READ_ONE))
        assert server.has(throttled=2)
        second.sendall(adu(READ_ONE))
        assert server.has(throttled=3)
        first.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        first.close()
        assert receive(second, ONE_ANSWER) == adu(ANSWER_ONE)


def test_frames_that_silence_completes_count_as_requests() -> None:
    with (
        served("plain", "rtu+tcp", requests_per_second=2, idle_timeout=1) as server,
        server.connect() as sly,
        server.connect() as idle,
    ):
        start = time.monotonic()
        for _ in range(40):
            sly.sendall(NEVER_ENDED + rtu(READ_ONE))
            time.sleep(0.05)
        seconds = time.monotonic() - start
        assert server.statistics.throttled >= 1
        # Its whole allowance, what one read may overdraw, and what it gets meanwhile.
        assert 3 <= server.statistics.requests <= 2 + 256 // 15 + 2 * seconds
        assert is_closed(idle)


def test_who_is_answered_when_silence_completes_its_frames_is_not_idle() -> None:
    with (
        served("plain", "rtu+tcp", idle_timeout=0.8) as server,
        server.connect() as sly,
        server.connect() as idle,
    ):
        answer = rtu(ANSWER_ONE)
        for _ in range(12):
            sly.sendall(NEVER_ENDED + rtu(READ_ONE))
            assert receive(sly, len(answer)) == answer
            time.sleep(0.1)
        assert server.has(connections=1, closed_idle=1, requests=12)
        assert is_closed(idle)


# --- who sends much ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scheme", "faulty"), [("rtu+tcp", False), ("ascii+tcp", False), ("tcp", False), ("tcp", True)]
)
def test_who_sends_little_does_not_wait_for_those_who_send_much(scheme: str, faulty: bool) -> None:
    """All of them are ready when the server comes to read."""
    encode = {
        "tcp": framing.TcpFramer().encode,
        "rtu+tcp": framing.RtuFramer("server").encode,
        "ascii+tcp": framing.AsciiFramer().encode,
    }[scheme]

    def request(address: int) -> bytes:
        return encode(framing.Frame(17, struct.pack(">BHH", 3, address, 1)))

    count, many = 20, 255 // len(request(0))
    is_blocked, goes_on = threading.Event(), threading.Event()
    order: list[int] = []

    def hook(access: Access) -> None:
        if access.address == 0:
            is_blocked.set()
            assert goes_on.wait(PATIENCE)
        order.append(access.address)

    device = Device(Mapping(holding_registers=125), before_read=hook)
    server = Server({17: device}, {None: [NEVER]} if faulty else None)
    with server.background(f"{scheme}://127.0.0.1:0") as running, ExitStack() as stack:
        port = int(running.urls[0].rpartition(":")[2])
        blocker, innocent, *attackers = (
            stack.enter_context(connect_from(f"127.0.0.{1 + number % 4}", port))
            for number in range(2 + count)
        )
        stack.callback(goes_on.set)
        while server.statistics.connections < 2 + count:
            time.sleep(0.005)
        blocker.sendall(request(0))
        assert is_blocked.wait(PATIENCE)
        for attacker in attackers:
            attacker.sendall(request(1) * many)
        innocent.sendall(request(2))
        goes_on.set()
        size = len(encode(framing.Frame(17, ANSWER_ONE)))
        for attacker in attackers:
            assert len(receive(attacker, many * size)) == many * size
        assert len(receive(innocent, size)) == size
    assert order.count(1) == count * many
    assert order.index(2) <= 4 * (count + 2)


# --- unknown_unit ------------------------------------------------------------------------


STRANGER = 99
REFUSED = bytes.fromhex("83 0b")


@pytest.mark.parametrize("scheme", ["tcp", "udp"])
@pytest.mark.parametrize("faulty", [False, True])
@pytest.mark.parametrize(
    ("policy", "answer"),
    [("refuse", REFUSED), ("silent", None)],
)
def test_a_unit_without_a_device(
    scheme: str, faulty: bool, policy: Any, answer: bytes | None
) -> None:
    faults = {None: [NEVER]} if faulty else None
    device = Device(Mapping(holding_registers=1))
    server = Server({17: device}, faults, unknown_unit=policy)
    kind = socket.SOCK_STREAM if scheme == "tcp" else socket.SOCK_DGRAM
    with (
        server.background(f"{scheme}://127.0.0.1:0") as running,
        socket.socket(type=kind) as client,
    ):
        client.settimeout(PATIENCE)
        client.connect(("127.0.0.1", int(running.urls[0].rpartition(":")[2])))
        client.sendall(adu(READ_ONE, 1, STRANGER))
        if answer is not None:
            assert client.recv(300) == adu(answer, 1, STRANGER)
        client.sendall(adu(READ_ONE, 2))
        assert client.recv(300) == adu(ANSWER_ONE, 2)
    assert server.statistics.requests == 2
    assert server.statistics.refused == (answer == REFUSED)


@pytest.mark.parametrize("policy", ["refuse", "silent"])
@pytest.mark.parametrize("line", ["rtu+tcp", "ascii+tcp", "rtu"])
def test_serial_lines_are_silent_for_a_unit_without_a_device(line: str, policy: Any) -> None:
    framer: framing.Framer = framing.AsciiFramer()
    if line.startswith("rtu"):
        framer = framing.RtuFramer("server")
    server = Server({17: Device(Mapping(holding_registers=1))}, unknown_unit=policy)
    requests = [framer.encode(framing.Frame(unit, READ_ONE)) for unit in (STRANGER, 17)]
    answer = framer.encode(framing.Frame(17, ANSWER_ONE))
    with ExitStack() as stack:
        if line == "rtu":
            wire = stack.enter_context(SerialWire())
            stack.enter_context(server.background(f"rtu://{wire.server}?baudrate=115200"))
            port = os.open(wire.client, os.O_RDWR | os.O_NOCTTY)
            stack.callback(os.close, port)
            tty.setraw(port)
            for request in requests:
                os.write(port, request)
                time.sleep(0.05)
            assert select.select([port], [], [], PATIENCE)[0]
            time.sleep(0.05)
            assert os.read(port, 300) == answer
        else:
            running = stack.enter_context(server.background(f"{line}://127.0.0.1:0"))
            connection = connect(int(running.urls[0].rpartition(":")[2]))
            stack.enter_context(connection)
            connection.sendall(b"".join(requests))
            assert receive(connection, len(answer)) == answer
    assert server.statistics.requests == 2


# --- the command line --------------------------------------------------------------------


def test_serve_has_an_option_for_each_limit() -> None:
    command = [sys.executable, "-m", "libmodbus_py", "serve", "--help"]
    told = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=True)
    limits = [
        f"--{each.name.replace('_', '-')}" for each in dataclasses.fields(Limits) if each.init
    ]
    assert [name for name in limits if name not in told.stdout] == []


def test_serve_holds_its_clients_to_what_it_was_told() -> None:
    options = ["--max-connections", "2", "--frame-timeout", "0.3", "--idle-timeout", "inf"]
    with (
        ServerProcess(*options, "--max-unsent", "0", "--requests-per-second", "1000") as server,
        connect(server.port) as first,
        connect(server.port) as slow,
    ):
        ask(first)
        slow.sendall(b"\0")
        assert is_closed(slow)
        with connect(server.port) as second, connect(server.port) as third:
            assert is_closed(second)  # it never asked
            ask(third)
            ask(first)


@pytest.mark.parametrize(
    ("options", "closed"),
    [
        (["--allow", "192.0.2.0/24", "--allow", "127.0.0.1"], False),
        (["--allow", "192.0.2.0/24"], True),
        (["--max-connections", "1", "--when-full", "refuse"], False),
        (["--unknown-unit", "silent"], False),
    ],
)
def test_serve_takes_options_of_other_kinds(options: list[str], closed: bool) -> None:
    with ServerProcess(*options) as server, connect(server.port) as first:
        if closed:
            assert is_closed(first)
            return
        ask(first)
        if "--when-full" in options:
            with connect(server.port) as second:
                assert is_closed(second)
        ask(first)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--max-connections 0", "max_connections"),
        ("--max-connections many", "max-connections"),
        ("--connections-per-address 0", "connections_per_address"),
        ("--connections-per-address few", "connections-per-address"),
        ("--when-full drop", "when-full"),
        ("--frame-timeout 0", "frame_timeout"),
        ("--frame-timeout inf", "frame_timeout"),
        ("--frame-timeout nan", "frame_timeout"),
        ("--handshake-timeout 0", "handshake_timeout"),
        ("--idle-timeout -1", "idle_timeout"),
        ("--idle-timeout soon", "idle-timeout"),
        ("--max-unsent -1", "max_unsent"),
        ("--max-unsent 1.5", "max-unsent"),
        ("--allow 192.0.2.0/33", "allow"),
        ("--allow plant.example", "allow"),
        ("--requests-per-second 0", "requests_per_second"),
        ("--requests-per-second nan", "requests_per_second"),
        ("--unknown-unit ignore", "unknown-unit"),
    ],
)
def test_serve_with_a_limit_that_cannot_be_is_wrong_usage(options: str, named: str) -> None:
    command = [sys.executable, "-m", "libmodbus_py", "serve", "tcp://127.0.0.1:0"]
    done = subprocess.run(
        [*command, *options.split()], capture_output=True, text=True, timeout=PATIENCE
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert named in done.stderr
    assert done.stderr.count("\n") == 1


# --- no descriptors left -----------------------------------------------------------------


def test_without_descriptors_it_serves_whom_it_has_and_later_the_others() -> None:
    with ExitStack() as stack:
        with descriptor_limit(48):
            server = stack.enter_context(ServerProcess("--max-connections", "1000"))
        clients = [stack.enter_context(connect(server.port)) for _ in range(80)]
        for client in clients:
            client.sendall(adu(READ_ONE))
        assert receive(clients[0], ONE_ANSWER) == adu(ANSWER_ONE)
        time.sleep(0.3)
        assert server.descriptors() == 48
        waiting = [client for client in clients[1:] if not has_answer(client)]
        assert 32 <= len(waiting) < 79

        before = processor_time(server.pid)
        for _ in range(20):
            ask(clients[0])
            time.sleep(0.02)
        assert processor_time(server.pid) - before < 0.2  # it does not try without end

        for client in clients:
            if client not in waiting:
                client.close()
        for client in waiting:
            assert receive(client, ONE_ANSWER) == adu(ANSWER_ONE)
            client.close()


def has_answer(client: socket.socket) -> bool:
    return bool(select.select([client], [], [], 0)[0])


def processor_time(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


# --- statistics --------------------------------------------------------------------------


def assert_counted(statistics: ServerStatistics, **expected: int) -> None:
    counted = {name: value for name, value in asdict(statistics).items() if value}
    assert counted == expected


def test_a_session_over_tcp_is_counted(kind: str) -> None:
    with served(kind) as server:
        with server.connect() as first, server.connect() as second:
            for number in range(3):
                ask(first, number)
            first.sendall(adu(ILLEGAL_COUNT) + adu(READ_ONE, unit=STRANGER) + adu(b"\x63"))
            receive(first, 3 * 9)
            first.sendall(b"\0\1\0\7" + adu(READ_ONE)[4:])
            ask(first)
            second.sendall(adu(READ_ONE) + bytes(8))
            receive(second, ONE_ANSWER)
            assert is_closed(second)
            assert server.has(connections=1)
        assert server.has(connections=0)
        assert_counted(
            server.statistics,
            accepted=2,
            requests=8,
            refused=3,
            bad_frames=2,
            closed_out_of_step=1,
        )


def test_a_session_over_rtu_over_tcp_is_counted(kind: str) -> None:
    answer, refusal = rtu(ANSWER_ONE), rtu(b"\x83\x03")
    with served(kind, "rtu+tcp") as server:
        with server.connect() as client:
            client.sendall(rtu(READ_ONE) + rtu(READ_ONE, STRANGER) + rtu(ILLEGAL_COUNT))
            assert receive(client, len(answer + refusal)) == answer + refusal
            damaged = bytearray(rtu(READ_ONE))
            damaged[-1] ^= 0xFF
            client.sendall(damaged)
            assert server.has(bad_frames=1)
            client.sendall(rtu(READ_ONE))
            assert receive(client, len(answer)) == answer
        assert server.has(connections=0)
        assert_counted(server.statistics, accepted=1, requests=4, refused=1, bad_frames=1)


def test_a_session_over_udp_is_counted(kind: str) -> None:
    with (
        served(kind, "udp") as server,
        socket.socket(type=socket.SOCK_DGRAM) as client,
    ):
        client.settimeout(PATIENCE)
        client.connect(("127.0.0.1", server.port))
        for datagram in (adu(READ_ONE)[:-1], adu(READ_ONE), adu(ILLEGAL_COUNT), b"", adu(READ_ONE)):
            client.send(datagram)
        answers = [client.recv(300) for _ in range(3)]
        assert answers == [adu(ANSWER_ONE), adu(b"\x83\x03"), adu(ANSWER_ONE)]
        assert server.has(requests=3)
        assert_counted(server.statistics, requests=3, refused=1, bad_frames=1)
