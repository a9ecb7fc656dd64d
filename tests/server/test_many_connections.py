"""
As many connections as descriptors allow, and very many one after the other: all are
served, and the server's process is afterwards what it was before.
"""

import gc
import os
import socket
import stat
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import pytest

from libmodbus_py import Device, Mapping, Server
from tests.simulation.lan import Lan
from tests.support.attacks import (
    ANSWER_ONE,
    PATIENCE,
    READ_ONE,
    ServerProcess,
    adu,
    churn,
    connect,
    descriptor_limit,
    pipeline,
    receive,
)
from tests.support.lan_server import ONE_ANSWER, OVER_TCP, LanServer, ask, server_on
from tests.support.peers import until

# They are for whoever asks for a report, in whatever format.
pytestmark = pytest.mark.filterwarnings("ignore:record_property is incompatible")

Record = Callable[[str, object], None]

# More than 1024, beyond which select() and the system's first limit end.
WANTED = 1500
ALL_FROM_HERE = ("--connections-per-address", "1000000")
# Descriptors that this process and the server need beside their connections.
SPARE = 100

# What the memory of a process may grow by though nothing leaks: malloc keeps pages that it
# got back. Starting leaves about 1 MB free, which hides as much of a leak. What Python allocates
# is counted to the byte on the LAN.
SLACK = 600_000
WARM_UP = 300
CYCLES = 1_200
REQUESTS = 100_000


def test_fifteen_hundred_connections_at_once_are_served(record_property: Record) -> None:
    with (
        descriptor_limit() as descriptors,
        ServerProcess(*ALL_FROM_HERE) as server,
        ExitStack() as stack,
    ):
        count = min(WANTED, descriptors - SPARE)
        if count < WANTED:
            print(f"only {count} connections: the limit of descriptors is {descriptors}")
        churn(server.port, WARM_UP)
        opened = server.settled_descriptors()
        # The first ones find room in memory that starting left over.
        some = count // 5
        connections = [stack.enter_context(connect(server.port)) for _ in range(some)]
        wait_until_accepted(server, opened + some)
        before = server.resident()
        connections += [stack.enter_context(connect(server.port)) for _ in range(count - some)]
        wait_until_accepted(server, opened + count)
        grown = server.resident() - before
        record_property("connections", count)
        record_property("bytes per idle connection", grown // (count - some))
        for turn in (1, 2):
            # All have asked before the first one reads.
            for number, connection in enumerate(connections):
                connection.sendall(adu(READ_ONE, number * turn & 0xFFFF))
            for number, connection in enumerate(connections):
                answer = adu(ANSWER_ONE, number * turn & 0xFFFF)
                assert receive(connection, len(answer)) == answer
        assert server.descriptors() == opened + count
        stack.close()
        assert server.has_descriptors(opened)


def wait_until_accepted(server: ServerProcess, descriptors: int) -> None:
    until(lambda: server.descriptors() >= descriptors)


@pytest.mark.parametrize(
    ("work", "count"), [(churn, CYCLES), (pipeline, REQUESTS)], ids=["cycles", "requests"]
)
def test_closed_connections_leave_no_descriptor(work, count, record_property) -> None:
    with ServerProcess() as server:
        work(server.port, count // 4)
        descriptors = server.settled_descriptors()
        threads, resident = server.threads(), server.resident()
        work(server.port, count)
        assert server.has_descriptors(descriptors)
        grown = server.resident() - resident
        record_property("bytes grown", grown)
        assert server.threads() == threads
        assert grown < SLACK


def come_and_go(server: LanServer, cycles: int) -> None:
    """Connect, ask and leave, by turns well, in the middle of a request, and with a reset."""
    for number in range(cycles):
        client = server.connect(f"10.1.0.{1 + number % 20}")
        ask(client, number & 0xFFFF)
        if number % 3:
            client.sendall(adu(READ_ONE)[:5])
        (client.reset if number % 3 == 2 else client.close)()
        assert server.counts(connections=0)


def ask_on(server: LanServer, cycles: int) -> None:
    client = server.connect()
    for _ in range(cycles):
        client.sendall(adu(READ_ONE) * 20)
        assert client.receive(20 * ONE_ANSWER) == adu(ANSWER_ONE) * 20
    client.close()
    assert server.counts(connections=0)


@pytest.mark.parametrize("kind", OVER_TCP)
@pytest.mark.parametrize("work", [come_and_go, ask_on])
def test_closed_connections_leave_no_memory_in_the_server(lan: Lan, kind, work) -> None:
    """A leak of one object in ten cycles shows."""
    package = [tracemalloc.Filter(True, "*/libmodbus_py/*")]

    def allocated() -> int:
        gc.collect()
        figures = tracemalloc.take_snapshot().filter_traces(package).statistics("filename")
        return sum(figure.count for figure in figures)

    with server_on(lan, kind) as server:
        work(server, 60)
        tracemalloc.start()
        try:
            work(server, 30)
            before = allocated()
            work(server, 150)
            assert allocated() - before < 15
        finally:
            tracemalloc.stop()


READ, ANSWER = bytes.fromhex("03 0001 0001"), bytes.fromhex("03 02 0000")


@contextmanager
def without_standard_input() -> Iterator[None]:
    """Leave descriptor 0 to whatever is opened next."""
    copy = os.dup(0)
    os.close(0)
    try:
        yield
    finally:
        os.dup2(copy, 0)
        os.close(copy)


@pytest.mark.parametrize("ends_well", [True, False])
def test_the_connection_of_a_client_may_be_the_first_descriptor(ends_well: bool) -> None:
    server = Server(Device(Mapping(holding_registers=4)))
    with server.background("tcp://127.0.0.1:0") as running, socket.socket() as client:
        client.settimeout(PATIENCE)
        with without_standard_input():
            client.connect(("127.0.0.1", int(running.urls[0].rpartition(":")[2])))
            for number in range(3):
                client.sendall(adu(READ, number))
                assert client.recv(100) == adu(ANSWER, number)
            assert stat.S_ISSOCK(os.fstat(0).st_mode)
            if not ends_well:
                client.sendall(b"\xff" * 7)
            else:
                client.shutdown(socket.SHUT_WR)
            assert client.recv(100) == b""
            until(lambda: server.statistics.connections == 0)
