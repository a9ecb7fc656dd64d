"""
What is measured: a cell for each number of the tables, and how it is come by.

Every section starts all its servers and clients, gives its cells, and ends them.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from bench.children import (
    Child,
    Failed,
    on_one_processor,
    processor_time,
    python,
    run,
    wait_until_idle,
)


class Key(NamedTuple):
    """The cell of a number in the tables."""

    section: str
    variant: str
    name: str


@dataclass(frozen=True)
class Measured:
    """
    One round of a cell.

    Attributes:
        client_cpu, server_cpu: seconds of processor time.
        p50, p99: microseconds from request to answer, if they were taken.
        note: why this is not a number to compare with others; empty if it is one.
    """

    requests: int
    seconds: float
    client_cpu: float
    server_cpu: float
    p50: float | None = None
    p99: float | None = None
    note: str = ""


Cells = dict[Key, Callable[[float], Measured]]


OURS = "libmodbus_py"
BEFORE = "libmodbus_py, before"  # another state of this package, with an interpreter of its own
C = "C"  # the program is one of ours in C, not in Python


class Peer(NamedTuple):
    """A program: its name, the command that runs it, and the package it needs, or `C`."""

    name: str
    program: str
    package: str = OURS

    @property
    def before(self) -> Peer:
        return Peer(before(self.name), self.program, BEFORE)


def before(name: str) -> str:
    return f"{name}, before"


@dataclass(frozen=True)
class Tools:
    """
    What peers are run with.

    Attributes:
        programs: where the programs in C are.
        ours: the interpreter that has the package to measure.
        before: one that has another state of it, which then takes turns with it.
    """

    programs: Path
    ours: str = sys.executable
    before: str = ""

    def command(self, peer: Peer, script: str, *arguments: str) -> list[str]:
        if peer.package == C:
            return [str(self.programs / peer.program), *arguments]
        interpreter = {OURS: self.ours, BEFORE: self.before}.get(peer.package, sys.executable)
        return python(script, peer.program, *arguments, interpreter=interpreter)

    def present(self, peers: list[Peer]) -> Iterator[Peer]:
        """Return the peers whose package is installed; ours twice if there is a `before`."""
        for peer in peers:
            if is_present(peer):
                yield peer
            if self.before and peer.package == OURS:
                yield peer.before


def is_present(peer: Peer) -> bool:
    return peer.package == C or find_spec(peer.package) is not None


C_CLIENT = "libmodbus, client in C"
C_SERVER = "libmodbus, server in C"
OUR_SERVER = "Server"
READ_HOOK_SERVER = "Server, hook for all reads"
WRITE_HOOK_SERVER = "Server, hook for writes"
METERED_SERVER = "Server, metrics scraped each second"
TRIVIAL_SERVER = "no Modbus: answers in C"

CONTEXT, CLIENT = "TcpContext", "Client"
CLIENT_BULK, ASYNC_BULK = "Client.execute_many", "AsyncClient.execute_many"

TCP_CLIENTS = [
    Peer(C_CLIENT, "client", C),
    Peer(CONTEXT, "tcp-context"),
    Peer(CLIENT, "tcp-client"),
    Peer("pylibmodbus", "pylibmodbus", "pylibmodbus"),
    Peer("pymodbus", "pymodbus", "pymodbus"),
    Peer("pyModbusTCP", "pyModbusTCP", "pyModbusTCP"),
    Peer("uModbus", "uModbus", "umodbus"),
]
RTU_CLIENTS = [
    Peer(C_CLIENT, "client", C),
    Peer("RtuContext", "rtu-context"),
    Peer("Client, rtu", "rtu-client"),
    Peer("Client, rtu, silence=0", "rtu-client-hasty"),
    Peer("pymodbus", "pymodbus-rtu", "pymodbus"),
    Peer("minimalmodbus", "minimalmodbus", "minimalmodbus"),
    Peer("uModbus", "uModbus-rtu", "umodbus"),
]
ASYNC_CLIENTS = [
    Peer(C_CLIENT, "client", C),
    Peer("AsyncClient", "async-one"),
    Peer("AsyncClient, 64 gathered", "async-gather-64"),
    Peer("pymodbus, async", "pymodbus-async", "pymodbus"),
]
BULK_CLIENTS = [
    Peer(C_CLIENT, "client", C),
    Peer(CLIENT_BULK, "client-execute-many"),
    Peer(ASYNC_BULK, "async-execute-many"),
    Peer("AsyncClient, gather", "async-gather"),
    Peer("pymodbus, async", "pymodbus-async", "pymodbus"),
    Peer("pyModbusTCP", "pyModbusTCP", "pyModbusTCP"),
]
C_TCP_SERVER, C_RTU_SERVER = Peer(C_SERVER, "many", C), Peer(C_SERVER, "rtu", C)
OUR_TCP_SERVER = Peer(OUR_SERVER, "ours")
SERVERS = [
    C_TCP_SERVER,
    OUR_TCP_SERVER,
    Peer(READ_HOOK_SERVER, "ours-with-read-hook"),
    Peer(WRITE_HOOK_SERVER, "ours-with-write-hook"),
    Peer(METERED_SERVER, "ours-with-metrics", "prometheus_client"),
    Peer("pymodbus", "pymodbus", "pymodbus"),
    Peer("pyModbusTCP", "pyModbusTCP", "pyModbusTCP"),
    Peer(TRIVIAL_SERVER, "answer", C),
]
PEERS = [*TCP_CLIENTS, *RTU_CLIENTS, *ASYNC_CLIENTS, *BULK_CLIENTS, *SERVERS]
OUR_NAMES = {peer.name for peer in PEERS if peer.package == OURS}

BLOCKING, ASYNCIO, BULK, SERVER, LIMIT = "blocking", "asyncio", "bulk", "servers", "limit"
FREE, ONE_PROCESSOR = "TCP", "TCP, on one processor"  # from libmodbus's server
OURS_FREE, OURS_ONE_PROCESSOR = "TCP, our server", "TCP, our server, on one processor"
# Client and minimalmodbus keep the specified 1.75 ms of silence, pymodbus looks every
# millisecond; libmodbus and uModbus do neither.
RTU = "RTU on a pseudo-terminal"
TO_OURS, TO_C = "to our server", "to libmodbus's server"
TO_C_ON_ONE = "to libmodbus's server, on one processor"  # which says most about small differences

# Blocks and registers in each.
SMALL = ("1000", "10")
SMALL_ON_SERIAL_LINES = ("100", "10")
LARGE = ("800", "125")
LOADS = [(connections, flight) for flight in (1, 16) for connections in (1, 8, 100, 1000)]
# Bytes of a request and of its answer.
SIZES = {"10 registers": (12, 29), "125 registers": (12, 259)}


def load_name(connections: int, in_flight: int) -> str:
    return f"{connections} x {in_flight}"


def absent() -> list[str]:
    """Return the packages that are not installed."""
    return sorted({peer.package for peer in PEERS if not is_present(peer)})


# --- servers ------------------------------------------------------------------------------


class RunningServer:
    """A server that can be started again, should it die."""

    def __init__(self, stack: ExitStack, command: list[str]) -> None:
        self._stack = stack
        self._command = command
        self.start()

    def start(self) -> None:
        self.child = self._stack.enter_context(Child(self._command))
        self.place = self.child.read_line()
        self.descriptors = len(os.listdir(f"/proc/{self.child.pid}/fd"))

    def ready(self) -> None:
        """Check that the server is alive, and that the clients of the last cell are gone."""
        if not self.child.is_alive:
            self.start()
        wait_until_idle(self.child.pid, self.descriptors)


def start_server(stack: ExitStack, tools: Tools, peer: Peer) -> RunningServer:
    return RunningServer(stack, tools.command(peer, "servers.py"))


# --- clients ------------------------------------------------------------------------------


def start_client(
    stack: ExitStack, tools: Tools, peer: Peer, place: str, work: tuple[str, str]
) -> Child:
    transport = [] if peer.package != C else ["rtu" if place.startswith("/") else "tcp"]
    return stack.enter_context(Child(tools.command(peer, "clients.py", *transport, place, *work)))


def measure_client(
    client: Child, server: RunningServer, seconds: float, *, on_one: bool = False
) -> Measured:
    server.ready()
    place = on_one_processor(client.pid, server.child.pid) if on_one else nullcontext()
    with place:
        start = processor_time(server.child.pid)
        result = client.order(str(seconds))
        server_cpu = processor_time(server.child.pid) - start
    if "failed" in result:
        raise Failed(result["failed"])
    return Measured(**result, server_cpu=server_cpu)


def client_cells(
    stack: ExitStack,
    tools: Tools,
    peers: list[Peer],
    server: RunningServer,
    work: tuple[str, str],
) -> Iterator[tuple[str, Callable[..., Measured]]]:
    started = [
        (peer.name, start_client(stack, tools, peer, server.place, work))
        for peer in tools.present(peers)
    ]
    for name, client in started:
        try:
            client.read_line()
        except Failed as failure:
            yield name, partial(fail, str(failure))
        else:
            yield name, partial(measure_client, client, server)


def fail(why: str, *_: object, **__: object) -> Measured:
    raise Failed(why)


# --- sections -----------------------------------------------------------------------------


def blocking(stack: ExitStack, tools: Tools) -> Cells:
    """Ten holding registers at a time, one request in flight."""
    cells: Cells = {}
    for peer, free, on_one in (
        (C_TCP_SERVER, FREE, ONE_PROCESSOR),
        (OUR_TCP_SERVER, OURS_FREE, OURS_ONE_PROCESSOR),
    ):
        tcp = start_server(stack, tools, peer)
        for name, measure in client_cells(stack, tools, TCP_CLIENTS, tcp, SMALL):
            cells[Key(BLOCKING, free, name)] = measure
            cells[Key(BLOCKING, on_one, name)] = partial(measure, on_one=True)
    rtu = start_server(stack, tools, C_RTU_SERVER)
    for name, measure in client_cells(stack, tools, RTU_CLIENTS, rtu, SMALL_ON_SERIAL_LINES):
        cells[Key(BLOCKING, RTU, name)] = measure
    return cells


def with_asyncio(stack: ExitStack, tools: Tools) -> Cells:
    """Ten holding registers at a time; the client in C to compare with has one in flight."""
    return on_both_servers(stack, tools, ASYNCIO, ASYNC_CLIENTS, SMALL)


def bulk(stack: ExitStack, tools: Tools) -> Cells:
    """100 000 registers in blocks of 125; ours have 16 requests in flight, the others one."""
    return on_both_servers(stack, tools, BULK, BULK_CLIENTS, LARGE)


def on_both_servers(
    stack: ExitStack, tools: Tools, section: str, peers: list[Peer], work: tuple[str, str]
) -> Cells:
    cells: Cells = {}
    for variant, peer in ((TO_OURS, OUR_TCP_SERVER), (TO_C, C_TCP_SERVER)):
        server = start_server(stack, tools, peer)
        for name, measure in client_cells(stack, tools, peers, server, work):
            cells[Key(section, variant, name)] = measure
            if variant == TO_C:
                cells[Key(section, TO_C_ON_ONE, name)] = partial(measure, on_one=True)
    return cells


def servers(stack: ExitStack, tools: Tools) -> Cells:
    """Ten holding registers at a time: connections x requests in flight on each."""
    cells: Cells = {}
    for peer in tools.present(SERVERS):
        measure = server_measure(stack, tools, peer)
        for load in LOADS:
            cells[Key(SERVER, load_name(*load), peer.name)] = partial(measure, *load)
    return cells


def server_measure(stack: ExitStack, tools: Tools, peer: Peer) -> Callable[..., Measured]:
    try:
        server = start_server(stack, tools, peer)
    except Failed as failure:
        return partial(fail, str(failure))
    return partial(measure_server, str(tools.programs / "load"), server)


def measure_server(
    generator: str, server: RunningServer, connections: int, in_flight: int, seconds: float
) -> Measured:
    server.ready()
    arguments = [server.place, connections, in_flight, seconds, server.child.pid]
    result = run([generator, *map(str, arguments)])
    if not server.child.is_alive:
        raise Failed("the server died")
    return Measured(
        requests=result["requests"],
        seconds=result["seconds"],
        client_cpu=result["load_cpu"],
        server_cpu=result["server_cpu"],
        p50=result["p50"],
        p99=result["p99"],
        note=what_went_wrong(result, connections, in_flight),
    )


def what_went_wrong(result: dict[str, int], connections: int, in_flight: int) -> str:
    if result["connections"] < connections:
        return f"{result['connections']} of {connections} connections: {result['first_error']}"
    if result["errors"]:
        return f"{result['errors']} errors: {result['first_error']}"
    if result["missing"] == connections * (in_flight - 1) > 0:
        return f"answers 1 of {in_flight}"
    if result["missing"]:
        return f"{result['missing']} requests not answered"
    return ""


def limit(_: ExitStack, tools: Tools) -> Cells:
    """Two processes in C that send each other as many bytes as request and answer have."""
    measure = partial(measure_pingpong, str(tools.programs / "pingpong"))
    return {Key(LIMIT, FREE, name): partial(measure, sizes) for name, sizes in SIZES.items()} | {
        Key(LIMIT, ONE_PROCESSOR, name): partial(measure, sizes, on_one=True)
        for name, sizes in SIZES.items()
    }


def measure_pingpong(
    program: str, sizes: tuple[int, int], seconds: float, *, on_one: bool = False
) -> Measured:
    # Children run on the processors of their parent.
    with on_one_processor(os.getpid()) if on_one else nullcontext():
        return Measured(**run([program, *map(str, sizes), str(seconds)]))


SECTIONS: dict[str, Callable[[ExitStack, Tools], Cells]] = {
    BLOCKING: blocking,
    ASYNCIO: with_asyncio,
    BULK: bulk,
    SERVER: servers,
    LIMIT: limit,
}


@contextmanager
def cells_of(section: str, tools: Tools) -> Iterator[Cells]:
    """Return the cells of a section while its processes run."""
    with ExitStack() as stack:
        yield SECTIONS[section](stack, tools)
