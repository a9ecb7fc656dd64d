"""
As many connections as descriptors allow, and very many one after the other: all are
served, and the server's process is afterwards what it was before.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack

import pytest

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

# They are for whoever asks for a report, in whatever format.
pytestmark = pytest.mark.filterwarnings("ignore:record_property is incompatible")

Record = Callable[[str, object], None]

WANTED = 5000
ALL_FROM_HERE = ("--connections-per-address", "1000000")
# Descriptors that this process and the server need beside their connections.
SPARE = 100

# What the memory of a process may grow by though nothing leaks: malloc keeps pages that it
# got back. Starting leaves about 1 MB free, which hides as much of a leak; with both, 300
# bytes in each cycle or 3 in each request still show.
SLACK = 600_000
WARM_UP = 500
CYCLES = 6_000
REQUESTS = 600_000


def test_five_thousand_connections_at_once_are_served(record_property: Record) -> None:
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
                expected = adu(ANSWER_ONE, number * turn & 0xFFFF)
                assert receive(connection, len(expected)) == expected
        assert server.descriptors() == opened + count
        stack.close()
        assert server.has_descriptors(opened)


def wait_until_accepted(server: ServerProcess, descriptors: int) -> None:
    deadline = time.monotonic() + PATIENCE
    while server.descriptors() < descriptors:
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.parametrize(
    ("work", "count"), [(churn, CYCLES), (pipeline, REQUESTS)], ids=["cycles", "requests"]
)
def test_what_comes_and_goes_leaves_nothing(
    work: Callable[[int, int], None], count: int, record_property: Record
) -> None:
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
