"""
A client, or a fleet, that sends so many requests and ends: programs.py NAME PLACE REQUESTS

What ./run bench --instructions counts. PLACE is a port on 127.0.0.1, where holding register N
must hold N. Prints the number of requests that were sent.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Sequence
from typing import Any

HOST = "127.0.0.1"
IN_FLIGHT = 16
REGISTERS = 10

Values = Sequence[int]


def check(values: Values) -> None:
    if list(values) != list(range(REGISTERS)):
        raise ValueError("wrong values")


def one_by_one(read: Callable[[], Values], requests: int) -> None:
    for _ in range(requests):
        values = read()
    check(values)


# --- ours -------------------------------------------------------------------------------


def context(place: str, requests: int) -> None:
    from libmodbus_py import TcpContext

    with TcpContext(HOST, int(place), unit=1) as context:
        one_by_one(lambda: context.read_holding_registers(0, REGISTERS), requests)


def client(place: str, requests: int) -> None:
    from libmodbus_py import Client

    with Client(f"tcp://{HOST}:{place}") as client:
        one_by_one(lambda: client.read_holding_registers(0, REGISTERS), requests)


def execute_many(place: str, requests: int) -> None:
    from libmodbus_py import Client, pdu

    with Client(f"tcp://{HOST}:{place}", max_in_flight=IN_FLIGHT) as client:
        reads = [pdu.ReadHoldingRegisters(0, REGISTERS)] * requests
        check(client.execute_many(reads)[-1])


async def async_execute_many(place: str, requests: int) -> None:
    from libmodbus_py import AsyncClient, pdu

    async with AsyncClient(f"tcp://{HOST}:{place}", max_in_flight=IN_FLIGHT) as client:
        reads = [pdu.ReadHoldingRegisters(0, REGISTERS)] * requests
        check((await client.execute_many(reads))[-1])


async def async_client(place: str, requests: int) -> None:
    from libmodbus_py import AsyncClient

    async with AsyncClient(f"tcp://{HOST}:{place}") as client:
        for _ in range(requests):
            values = await client.read_holding_registers(0, REGISTERS)
        check(values)


async def gather(place: str, requests: int) -> None:
    from libmodbus_py import AsyncClient

    async with AsyncClient(f"tcp://{HOST}:{place}", max_in_flight=IN_FLIGHT) as client:
        for start in range(0, requests, IN_FLIGHT):
            count = min(IN_FLIGHT, requests - start)
            reads = (client.read_holding_registers(0, REGISTERS) for _ in range(count))
            values = await asyncio.gather(*reads)
        check(values[-1])


async def fleet(place: str, requests: int) -> int:
    """
    Poll a device 20 times a second, for 10 ms for each of the requests; return the polls.

    Polls of several devices begin in one turn of the event loop, and cost less, if they are late.
    """
    from libmodbus_py import Fleet, Point, RegisterMap
    from libmodbus_py.fleet import DeviceConfig

    points = RegisterMap(
        Point(f"p{at}", "holding_registers", at, scale=0.1) for at in range(REGISTERS)
    )
    device = DeviceConfig("device", f"tcp://{HOST}:{place}", points, interval=0.05)
    async with Fleet([device]) as fleet:
        await asyncio.sleep(requests * 0.01)
        return fleet.statistics.polls


# --- peers ------------------------------------------------------------------------------


def pylibmodbus(place: str, requests: int) -> None:
    from pylibmodbus import ModbusTcp

    client = ModbusTcp(HOST, int(place))
    client.connect()
    one_by_one(lambda: client.read_registers(0, REGISTERS), requests)
    client.close()


def pymodbustcp(place: str, requests: int) -> None:
    from pyModbusTCP.client import ModbusClient

    client = ModbusClient(HOST, int(place))
    one_by_one(lambda: client.read_holding_registers(0, REGISTERS), requests)
    client.close()


def pymodbus(place: str, requests: int) -> None:
    from pymodbus.client import ModbusTcpClient

    with ModbusTcpClient(HOST, port=int(place)) as client:
        one_by_one(lambda: client.read_holding_registers(0, count=REGISTERS).registers, requests)


async def pymodbus_async(place: str, requests: int) -> None:
    from pymodbus.client import AsyncModbusTcpClient

    client = AsyncModbusTcpClient(HOST, port=int(place))
    await client.connect()
    for _ in range(requests):
        response = await client.read_holding_registers(0, count=REGISTERS)
    check(response.registers)
    client.close()


PROGRAMS: dict[str, Callable[[str, int], Any]] = {
    "context": context,
    "client": client,
    "execute-many": execute_many,
    "async-execute-many": async_execute_many,
    "async": async_client,
    "async-gather": gather,
    "fleet": fleet,
    "pylibmodbus": pylibmodbus,
    "pyModbusTCP": pymodbustcp,
    "pymodbus": pymodbus,
    "pymodbus-async": pymodbus_async,
}


def main() -> None:
    name, place, count = sys.argv[1:]
    sent = PROGRAMS[name](place, requests := int(count))
    if asyncio.iscoroutine(sent):
        sent = asyncio.run(sent)
    print(sent or requests, flush=True)


if __name__ == "__main__":
    main()
