"""
Many requests given at once, with all defaults, to servers that keep one of the requests that arrive
together: that of pymodbus the last, a small device the first.

No request is lost, and writes are carried out in the order in which they were given.
"""

import asyncio
import contextlib
import struct
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import pytest
from pymodbus.pdu import ModbusPDU

from libmodbus_py import AsyncClient, Client, Gateway, Route, pdu
from tests.support.interop import HOLDING_REGISTERS, UNIT, holding_register
from tests.support.peers import FakeServer, mbap
from tests.support.pymodbus_peers import pymodbus_serving

REGISTER = HOLDING_REGISTERS.start  # the register of writes; reads begin after it

COUNT = 50
VALUES = list(range(1, COUNT + 1))
WRITES = [pdu.WriteRegister(REGISTER, value) for value in VALUES]
ADDRESSES = range(REGISTER + 4, REGISTER + 4 + COUNT)
READS = [pdu.ReadHoldingRegisters(address, 1) for address in ADDRESSES]
READ = [[holding_register(address)] for address in ADDRESSES]

READ_BACK = pdu.ReadHoldingRegisters(REGISTER, 1)
MIXED = [
    request
    for write, read in zip(WRITES, READS, strict=True)
    for request in (write, READ_BACK, read, read)
]
MIXED_RESULTS = [
    result
    for value, read in zip(VALUES, READ, strict=True)
    for result in (None, [value], read, read)
]


class Served(NamedTuple):
    """
    A server that runs. `url`: where it listens; `written`: address and value of each write that was
    carried out, the first one first.
    """

    url: str
    written: list[tuple[int, int]]

    @property
    def values(self) -> list[int]:
        """The values that `REGISTER` got, one after the other."""
        return [value for address, value in self.written if address == REGISTER]


@contextlib.contextmanager
def pymodbus() -> Iterator[Served]:
    """The server of pymodbus, which responds to the last request of what it receives together."""
    writes: list[tuple[int, int]] = []

    def note(sending: bool, message: ModbusPDU) -> ModbusPDU:
        if sending and message.function_code == 6:
            writes.append((message.address, message.registers[0]))
        return message

    with pymodbus_serving("tcp", trace_pdu=note) as url:
        yield Served(url, writes)


@contextlib.contextmanager
def first_frame() -> Iterator[Served]:
    """A device that responds to the first frame of what it receives together."""
    writes: list[tuple[int, int]] = []

    def answer(data: bytes) -> list[bytes]:
        function, address, word = struct.unpack_from(">BHH", data, 7)
        if function == 6:
            writes.append((address, word))
            return [mbap(data, data[7:12])]
        registers = {at: holding_register(at) for at in HOLDING_REGISTERS} | dict(writes)
        return [mbap(data, struct.pack(">BBH", function, 2, registers[address]))]

    with FakeServer(answer) as server:
        yield Served(server.url, writes)


SERVERS = {"pymodbus": pymodbus, "first frame": first_frame}


@pytest.fixture(params=SERVERS)
def served(request: pytest.FixtureRequest) -> Iterator[Served]:
    """Each kind of server."""
    with SERVERS[request.param]() as running:
        yield running


def gather(url: str, requests: list[Any]) -> tuple[list[Any], Any]:
    """Return the results of requests that a new client sends at once, and its statistics."""

    async def ask() -> tuple[list[Any], Any]:
        async with AsyncClient(url, unit=UNIT) as plc:
            tasks = [plc.execute(request) for request in requests]
            return await asyncio.gather(*tasks, return_exceptions=True), plc.statistics

    return asyncio.run(ask())


def execute_many(url: str, requests: list[Any]) -> tuple[list[Any], Any]:
    """Return the results of a blocking client, and its statistics."""
    with Client(url, unit=UNIT) as plc:
        return plc.execute_many(requests, return_exceptions=True), plc.statistics


Ask = Callable[[str, list[Any]], tuple[list[Any], Any]]

CLIENTS: dict[str, Ask] = {"asyncio": gather, "blocking": execute_many}


@pytest.mark.parametrize("client", CLIENTS)
def test_writes_are_carried_out_once_and_in_order(served: Served, client: str) -> None:
    results, statistics = CLIENTS[client](served.url, WRITES)
    assert results == [None] * COUNT
    assert served.values == VALUES
    assert statistics.requests == COUNT


@pytest.mark.parametrize("client", CLIENTS)
def test_reads_see_the_writes_before_them(served: Served, client: str) -> None:
    results, _ = CLIENTS[client](served.url, MIXED)
    assert results == MIXED_RESULTS
    assert served.values == VALUES


def test_writes_of_four_clients_of_a_gateway_are_carried_out(served: Served) -> None:
    """Each client writes a register of its own."""

    def ask(client: int) -> list[Any]:
        with Client(front, unit=UNIT, timeout=30) as plc:
            requests = [pdu.WriteRegister(REGISTER + client, value) for value in VALUES]
            return plc.execute_many(requests, return_exceptions=True)

    with Gateway([Route(served.url)]).background("tcp://127.0.0.1:0") as running:
        front = running.urls[0]
        with ThreadPoolExecutor(4) as pool:
            assert list(pool.map(ask, range(4))) == [[None] * COUNT] * 4
    for client in range(4):
        assert [
            value for address, value in served.written if address == REGISTER + client
        ] == VALUES


@pytest.mark.parametrize("client", CLIENTS)
def test_no_read_is_lost_or_sent_twice(served: Served, client: str) -> None:
    results, statistics = CLIENTS[client](served.url, READS)
    assert results == READ
    assert (statistics.requests, statistics.timeouts) == (COUNT, 0)
