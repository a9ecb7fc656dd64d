"""
Many requests at once for pymodbus's server, which keeps the last request of a connection only:
with our defaults each caller gets the value that he asked for.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from libmodbus_py import AsyncClient, Context, Gateway, Route, pdu
from tests.interop.test_interop_pymodbus import pymodbus_serving
from tests.support.interop import HOLDING_REGISTERS, UNIT, holding_register

FIRST = HOLDING_REGISTERS.start
ADDRESSES = range(FIRST, FIRST + 16)
VALUES = [[holding_register(address)] for address in ADDRESSES]
READS = [pdu.ReadHoldingRegisters(address, 1) for address in ADDRESSES]


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    with pymodbus_serving("tcp") as served:
        yield served


def test_every_read_of_a_gather_gets_its_value(url: str) -> None:
    async def ask() -> None:
        async with AsyncClient(url, unit=UNIT, timeout=1) as plc:
            for _ in range(5):
                reads = (plc.read_holding_registers(address, 1) for address in ADDRESSES)
                assert await asyncio.gather(*reads) == VALUES
            assert plc.max_in_flight < 16

    asyncio.run(ask())


@pytest.mark.parametrize("native", [True, False])
def test_every_request_of_a_batch_gets_its_value(url: str, native: bool) -> None:
    with Context.from_url(url, unit=UNIT, timeout=1, native=native) as plc:
        for _ in range(5):
            assert plc.execute_many(READS) == VALUES


def test_four_clients_of_a_gateway_get_their_values(url: str) -> None:
    with Gateway([Route(f"{url}?timeout=1")]).background("tcp://127.0.0.1:0") as running:
        front = running.urls[0]

        def ask(_: int) -> list[list[list[int]]]:
            with Context.from_url(front, unit=UNIT, timeout=30, max_in_flight=16) as plc:
                return [plc.execute_many(READS) for _ in range(10)]

        with ThreadPoolExecutor(4) as pool:
            assert list(pool.map(ask, range(4))) == [[VALUES] * 10] * 4
