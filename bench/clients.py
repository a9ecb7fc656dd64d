"""
One client in Python, in a process of its own: clients.py NAME PLACE BLOCKS COUNT

As client.c: for each line with a number of seconds it connects, reads BLOCKS blocks of
COUNT holding registers again and again for so long, and prints requests, seconds and
seconds of processor time as JSON. Register N must hold N, which is checked while the
clock stands. PLACE is a port on 127.0.0.1, or the path of a serial port.
"""

from __future__ import annotations

import asyncio
import gc
import json
import socket
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from functools import partial
from typing import Any, NamedTuple

REGISTERS = 65_500  # of the server; a multiple of 10 and of 125
HOST = "127.0.0.1"
BAUDRATE = 115_200
IN_FLIGHT = 16


class Block(NamedTuple):
    """The cells that one request reads."""

    address: int
    count: int


# Reads all blocks once.
Read = Callable[[], Sequence[Sequence[int]]]
# A place and what to read there -> a connected client.
Connect = Callable[[str, list[Block]], AbstractContextManager[Read]]


# --- ours -------------------------------------------------------------------------------


@contextmanager
def tcp_context(place: str, blocks: list[Block]) -> Iterator[Read]:
    from libmodbus_py import TcpContext

    with TcpContext(HOST, int(place)) as context:
        yield lambda: [context.read_holding_registers(*block) for block in blocks]


@contextmanager
def rtu_context(place: str, blocks: list[Block]) -> Iterator[Read]:
    from libmodbus_py import RtuContext

    with RtuContext(place, BAUDRATE, parity="N", unit=1) as context:
        yield lambda: [context.read_holding_registers(*block) for block in blocks]


@contextmanager
def tcp_client(place: str, blocks: list[Block]) -> Iterator[Read]:
    from libmodbus_py import Client

    with Client(f"tcp://{HOST}:{place}") as client:
        yield lambda: [client.read_holding_registers(*block) for block in blocks]


@contextmanager
def rtu_client(place: str, blocks: list[Block], **options: Any) -> Iterator[Read]:
    from libmodbus_py import Client

    with Client(f"rtu://{place}", baudrate=BAUDRATE, parity="N", unit=1, **options) as client:
        yield lambda: [client.read_holding_registers(*block) for block in blocks]


@contextmanager
def client_execute_many(place: str, blocks: list[Block]) -> Iterator[Read]:
    from libmodbus_py import Client, pdu

    requests = [pdu.ReadHoldingRegisters(*block) for block in blocks]
    with Client(f"tcp://{HOST}:{place}", max_in_flight=IN_FLIGHT) as client:
        yield lambda: client.execute_many(requests)


@contextmanager
def async_client(place: str, execute_all: Callable[[Any], Any]) -> Iterator[Read]:
    from libmodbus_py import AsyncClient

    with asyncio.Runner() as runner:
        client = AsyncClient(f"tcp://{HOST}:{place}", max_in_flight=IN_FLIGHT)
        runner.run(client.connect())
        yield lambda: runner.run(execute_all(client))
        runner.run(leave(client))


async def leave(client: Any) -> None:
    async with client:
        pass


def async_execute_many(place: str, blocks: list[Block]) -> AbstractContextManager[Read]:
    from libmodbus_py import pdu

    requests = [pdu.ReadHoldingRegisters(*block) for block in blocks]
    return async_client(place, lambda client: client.execute_many(requests))


def async_one(place: str, blocks: list[Block]) -> AbstractContextManager[Read]:
    async def read_all(client: Any) -> list[list[int]]:
        return [await client.read_holding_registers(*block) for block in blocks]

    return async_client(place, read_all)


def async_gather(
    place: str, blocks: list[Block], together: int | None = None
) -> AbstractContextManager[Read]:
    async def read_all(client: Any) -> list[list[int]]:
        values: list[list[int]] = []
        for some in batched(blocks, together or len(blocks)):
            reads = [client.read_holding_registers(*block) for block in some]
            values += await asyncio.gather(*reads)
        return values

    return async_client(place, read_all)


def batched(blocks: list[Block], size: int) -> Iterator[list[Block]]:
    return (blocks[at : at + size] for at in range(0, len(blocks), size))


# --- peers ------------------------------------------------------------------------------


@contextmanager
def pylibmodbus(place: str, blocks: list[Block]) -> Iterator[Read]:
    from pylibmodbus import ModbusTcp

    client = ModbusTcp(HOST, int(place))
    client.connect()
    with closing(client):
        yield lambda: [client.read_registers(*block) for block in blocks]


@contextmanager
def pymodbus(place: str, blocks: list[Block]) -> Iterator[Read]:
    from pymodbus.client import ModbusTcpClient

    with ModbusTcpClient(HOST, port=int(place)) as client:
        yield lambda: [
            client.read_holding_registers(address, count=count).registers
            for address, count in blocks
        ]


@contextmanager
def pymodbus_rtu(place: str, blocks: list[Block]) -> Iterator[Read]:
    from pymodbus.client import ModbusSerialClient

    with ModbusSerialClient(place, baudrate=BAUDRATE, parity="N") as client:
        yield lambda: [
            client.read_holding_registers(address, count=count).registers
            for address, count in blocks
        ]


@contextmanager
def pymodbus_async(place: str, blocks: list[Block]) -> Iterator[Read]:
    from pymodbus.client import AsyncModbusTcpClient

    # The client keeps one request in flight, so that gather would only be slower.
    async def read_all(client: Any) -> list[list[int]]:
        return [
            (await client.read_holding_registers(address, count=count)).registers
            for address, count in blocks
        ]

    async def connect() -> Any:
        client = AsyncModbusTcpClient(HOST, port=int(place))
        await client.connect()
        return client

    with asyncio.Runner() as runner:
        client = runner.run(connect())
        yield lambda: runner.run(read_all(client))
        client.close()


@contextmanager
def pymodbustcp(place: str, blocks: list[Block]) -> Iterator[Read]:
    from pyModbusTCP.client import ModbusClient

    with closing(ModbusClient(HOST, int(place))) as client:
        yield lambda: [client.read_holding_registers(*block) for block in blocks]


@contextmanager
def umodbus(place: str, blocks: list[Block]) -> Iterator[Read]:
    from umodbus.client import tcp

    with socket.create_connection((HOST, int(place))) as connection:
        yield lambda: [
            tcp.send_message(tcp.read_holding_registers(1, *block), connection) for block in blocks
        ]


@contextmanager
def umodbus_rtu(place: str, blocks: list[Block]) -> Iterator[Read]:
    from serial import Serial
    from umodbus.client.serial import rtu

    with Serial(place, BAUDRATE, timeout=1) as port:
        yield lambda: [
            rtu.send_message(rtu.read_holding_registers(1, *block), port) for block in blocks
        ]


@contextmanager
def minimalmodbus(place: str, blocks: list[Block]) -> Iterator[Read]:
    from minimalmodbus import Instrument

    instrument = Instrument(place, 1)
    instrument.serial.baudrate = BAUDRATE
    instrument.serial.timeout = 1
    with closing(instrument.serial):
        yield lambda: [instrument.read_registers(*block) for block in blocks]


CLIENTS: dict[str, Connect] = {
    "tcp-context": tcp_context,
    "rtu-context": rtu_context,
    "tcp-client": tcp_client,
    "rtu-client": rtu_client,
    "rtu-client-hasty": partial(rtu_client, silence=0),
    "client-execute-many": client_execute_many,
    "async-execute-many": async_execute_many,
    "async-gather": async_gather,
    "async-gather-64": partial(async_gather, together=64),
    "async-one": async_one,
    "pylibmodbus": pylibmodbus,
    "pymodbus": pymodbus,
    "pymodbus-rtu": pymodbus_rtu,
    "pymodbus-async": pymodbus_async,
    "pyModbusTCP": pymodbustcp,
    "uModbus": umodbus,
    "uModbus-rtu": umodbus_rtu,
    "minimalmodbus": minimalmodbus,
}


# --- the clock --------------------------------------------------------------------------


def measure(read: Read, blocks: list[Block], least: float) -> dict[str, float]:
    expected = [list(range(address, address + count)) for address, count in blocks]
    requests, seconds, processor = 0, 0.0, 0.0
    gc.collect()  # it does not pay for the round before
    while seconds < least:
        processor_start, start = time.process_time(), time.perf_counter()
        values = read()
        seconds += time.perf_counter() - start
        processor += time.process_time() - processor_start
        requests += len(blocks)
        if [list(value) for value in values] != expected:
            raise ValueError("wrong values")
    return {"requests": requests, "seconds": seconds, "client_cpu": processor}


def say(what: object) -> None:
    print(json.dumps(what), flush=True)


def main() -> None:
    name, place, blocks, count = sys.argv[1:]
    step = int(count)
    wanted = [Block(index * step % REGISTERS, step) for index in range(int(blocks))]
    say("ready")
    for line in sys.stdin:
        try:
            with CLIENTS[name](place, wanted) as read:
                say(measure(read, wanted, float(line)))
        except Exception as error:
            say({"failed": f"{type(error).__name__}: {error}"})


if __name__ == "__main__":
    main()
