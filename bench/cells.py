"""
What is measured: a cell for each number of the tables, and how it is come by.

Every section starts all its servers and clients, gives its cells, and ends them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from children import (
    Child,
    Failed,
    on_one_processor,
    processor_time,
    python,
    run,
    wait_until_idle,
)


class Key(NamedTuple):
    """Where a number stands."""

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
        note: why this is no number to compare with others; empty if it is one.
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
C = "C"  # the program is one of ours in C, not in Python


class Peer(NamedTuple):
    """A program: what it is called, what runs it, and the package it needs, or `C`."""

    name: str
    program: str
    package: str = OURS


C_CLIENT = "libmodbus, client in C"
C_SERVER = "libmodbus, server in C"
OUR_SERVER = "Server"
HOOKED_SERVER = "Server with a hook"
TRIVIAL_SERVER = "no Modbus: answers in C"

TCP_CLIENTS = [
    Peer(C_CLIENT, "client", C),
    Peer("TcpContext", "tcp-context"),
    Peer("TcpContext, native=True", "tcp-context-native"),
    Peer("TcpContext, native=False", "tcp-context-python"),
    Peer("pylibmodbus", "pylibmodbus", "pylibmodbus"),
    Peer("pymodbus", "pymodbus", "pymodbus"),
    Peer("pyModbusTCP", "pyModbusTCP", "pyModbusTCP"),
    Peer("uModbus", "uModbus", "umodbus"),
]
RTU_CLIENTS = [
    Peer(C_CLIENT, "client", C),
    Peer("RtuContext", "rtu-context"),
    Peer("RtuContext, silence=0", "rtu-context-hasty"),
    Peer("pymodbus", "pymodbus-rtu", "pymodbus"),
    Peer("minimalmodbus", "minimalmodbus", "minimalmodbus"),
    Peer("uModbus", "uModbus-rtu", "umodbus"),
]
BULK_CLIENTS = [
    Peer(C_CLIENT, "client", C),
    Peer("TcpContext.execute_many", "context-execute-many"),
    Peer("AsyncClient.execute_many", "async-execute-many"),
    Peer("AsyncClient, gather", "async-gather"),
    Peer("pymodbus, async", "pymodbus-async", "pymodbus"),
    Peer("pyModbusTCP", "pyModbusTCP", "pyModbusTCP"),
]
SERVERS = [
    Peer(C_SERVER, "many", C),
    Peer(OUR_SERVER, "ours"),
    Peer(HOOKED_SERVER, "ours-with-hook"),
    Peer("pymodbus", "pymodbus", "pymodbus"),
    Peer("pyModbusTCP", "pyModbusTCP", "pyModbusTCP"),
    Peer(TRIVIAL_SERVER, "answer", C),
]
PEERS = [*TCP_CLIENTS, *RTU_CLIENTS, *BULK_CLIENTS, *SERVERS]
OUR_NAMES = {peer.name for peer in PEERS if peer.package == OURS}

BLOCKING, BULK, SERVER, LIMIT = "blocking", "bulk", "servers", "limit"
FREE, ONE_PROCESSOR = "TCP", "TCP, client and server on one processor"
# RtuContext and minimalmodbus keep the specified 1.75 ms of silence, pymodbus looks every
# millisecond; libmodbus and uModbus do neither.
RTU = "RTU on a pseudo-terminal"
TO_OURS, TO_C = "to our server", "to libmodbus's server"

# Blocks and registers in each.
SMALL = ("1000", "10")
SMALL_ON_SERIAL_LINES = ("100", "10")
LARGE = ("800", "125")
LOADS = [(connections, flight) for flight in (1, 16) for connections in (1, 8, 100, 1000)]
# Bytes of a request and of its answer.
SIZES = {"10 registers": (12, 29), "125 registers": (12, 259)}


def load_name(connections: int, in_flight: int) -> str:
    return f"{connections} x {in_flight}"


def present(peers: list[Peer]) -> list[Peer]:
    return [peer for peer in peers if peer.package == C or find_spec(peer.package)]


def absent() -> list[str]:
    """Give the packages that are not installed."""
    return sorted({peer.package for peer in PEERS} - {peer.package for peer in present(PEERS)})


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
        """Have it alive, and rid of the clients of the last cell."""
        if not self.child.is_alive:
            self.start()
        wait_until_idle(self.child.pid, self.descriptors)


def server_command(peer: Peer, programs: Path) -> list[str]:
    if peer.package == C:
        return [str(programs / peer.program)]
    return python("servers.py", peer.program)


# --- clients ------------------------------------------------------------------------------


def start_client(
    stack: ExitStack, peer: Peer, programs: Path, place: str, work: tuple[str, str]
) -> Child:
    if peer.package == C:
        transport = "rtu" if place.startswith("/") else "tcp"
        command = [str(programs / peer.program), transport, place, *work]
    else:
        command = python("clients.py", peer.program, place, *work)
    return stack.enter_context(Child(command))


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
    peers: list[Peer],
    programs: Path,
    server: RunningServer,
    work: tuple[str, str],
) -> Iterator[tuple[str, Callable[..., Measured]]]:
    started = [
        (peer.name, start_client(stack, peer, programs, server.place, work))
        for peer in present(peers)
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


def blocking(stack: ExitStack, programs: Path) -> Cells:
    """Ten holding registers at a time, from libmodbus's server in C, one request in flight."""
    cells: Cells = {}
    tcp = RunningServer(stack, [str(programs / "many")])
    for name, measure in client_cells(stack, TCP_CLIENTS, programs, tcp, SMALL):
        cells[Key(BLOCKING, FREE, name)] = measure
        cells[Key(BLOCKING, ONE_PROCESSOR, name)] = partial(measure, on_one=True)
    rtu = RunningServer(stack, [str(programs / "rtu")])
    for name, measure in client_cells(stack, RTU_CLIENTS, programs, rtu, SMALL_ON_SERIAL_LINES):
        cells[Key(BLOCKING, RTU, name)] = measure
    return cells


def bulk(stack: ExitStack, programs: Path) -> Cells:
    """100 000 registers in blocks of 125; ours have 16 requests in flight, the others one."""
    cells: Cells = {}
    servers = {
        TO_OURS: python("servers.py", "ours"),
        TO_C: [str(programs / "many")],
    }
    for variant, command in servers.items():
        server = RunningServer(stack, command)
        for name, measure in client_cells(stack, BULK_CLIENTS, programs, server, LARGE):
            cells[Key(BULK, variant, name)] = measure
    return cells


def servers(stack: ExitStack, programs: Path) -> Cells:
    """Ten holding registers at a time: connections x requests in flight on each."""
    cells: Cells = {}
    for peer in present(SERVERS):
        measure = server_measure(stack, peer, programs)
        for load in LOADS:
            cells[Key(SERVER, load_name(*load), peer.name)] = partial(measure, *load)
    return cells


def server_measure(stack: ExitStack, peer: Peer, programs: Path) -> Callable[..., Measured]:
    try:
        server = RunningServer(stack, server_command(peer, programs))
    except Failed as failure:
        return partial(fail, str(failure))
    return partial(measure_server, str(programs / "load"), server)


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


def limit(stack: ExitStack, programs: Path) -> Cells:
    """Two processes in C that send each other as many bytes as request and answer have."""
    return {
        Key(LIMIT, FREE, name): partial(measure_pingpong, str(programs / "pingpong"), sizes)
        for name, sizes in SIZES.items()
    } | {
        Key(LIMIT, ONE_PROCESSOR, name): partial(
            measure_pingpong, str(programs / "pingpong"), sizes, on_one=True
        )
        for name, sizes in SIZES.items()
    }


def measure_pingpong(
    program: str, sizes: tuple[int, int], seconds: float, *, on_one: bool = False
) -> Measured:
    # Children are where their parent is.
    with on_one_processor(os.getpid()) if on_one else nullcontext():
        return Measured(**run([program, *map(str, sizes), str(seconds)]))


SECTIONS: dict[str, Callable[[ExitStack, Path], Cells]] = {
    BLOCKING: blocking,
    BULK: bulk,
    SERVER: servers,
    LIMIT: limit,
}


@contextmanager
def cells_of(section: str, programs: Path) -> Iterator[Cells]:
    """Give the cells of a section while its processes run."""
    with ExitStack() as stack:
        yield SECTIONS[section](stack, programs)
