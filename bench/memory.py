"""
What an idle connection costs a server in resident memory; the kernel's share is not counted.
"""

from __future__ import annotations

import resource
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from bench.cells import SERVERS, RunningServer, Tools, start_server
from bench.children import Failed, resident_memory

FEW, MANY = 100, 1000  # connections
WITHIN = 20.0  # seconds for all connections
REQUEST = bytes.fromhex("0001 0000 0006 01 03 0000 000a")
ANSWER_SIZE = 29


@dataclass(frozen=True)
class Memory:
    """
    Attributes:
        few: resident bytes with `FEW` connections.
        each: further bytes for each connection more, up to `connections`.
        note: what went wrong, or nothing.
    """

    few: int
    each: float
    connections: int
    note: str = ""


def measure_memory(tools: Tools) -> dict[str, Memory | str]:
    """Return the memory of every server, freshly started; or the reason why there is none."""
    raise_descriptor_limit()
    found: dict[str, Memory | str] = {}
    for peer in tools.present(SERVERS):
        with ExitStack() as stack:
            try:
                server = start_server(stack, tools, peer)
                found[peer.name] = measure_server(server)
            except (Failed, OSError) as failure:
                found[peer.name] = str(failure)
    return found


def raise_descriptor_limit() -> None:
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def measure_server(server: RunningServer) -> Memory:
    port, pid = int(server.place), server.child.pid
    with connected(port, FEW) as first:
        few = resident_memory(pid)
        with connected(port, MANY - FEW) as more:
            each = (resident_memory(pid) - few) / max(1, len(more))
    count = len(first) + len(more)
    note = "" if count == MANY else f"{count} of {MANY} connections"
    return Memory(few, each, count, note)


@contextmanager
def connected(port: int, count: int) -> Iterator[list[socket.socket]]:
    """Return those connections that got an answer; they say no more."""
    end = time.monotonic() + WITHIN
    with ExitStack() as stack:
        yield [each for _ in range(count) if (each := connect(stack, port, end - time.monotonic()))]


def connect(stack: ExitStack, port: int, timeout: float) -> socket.socket | None:
    if timeout <= 0:
        return None
    try:
        client = stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout))
        client.sendall(REQUEST)
        if len(client.recv(ANSWER_SIZE, socket.MSG_WAITALL)) < ANSWER_SIZE:
            return None
    except OSError:
        return None
    return client
