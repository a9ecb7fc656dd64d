"""
UDP, in both directions, against pymodbus.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from pymodbus.client import ModbusUdpClient
from pymodbus.server import ModbusUdpServer

from libmodbus_py import AsyncClient, Context, IllegalDataAddress, Server, pdu
from tests.interop.test_interop_pymodbus_server import in_background, simulated_device
from tests.support.interop import (
    UNIT,
    coil,
    discrete_input,
    holding_register,
    input_register,
    make_device,
)


@pytest.fixture
def theirs() -> Iterator[Any]:
    """Their client, on our server."""
    with Server({UNIT: make_device()}).background("udp://127.0.0.1:0") as running:
        port = int(running.urls[0].rpartition(":")[2])
        client = ModbusUdpClient("127.0.0.1", port=port, timeout=2, retries=0)
        assert client.connect()
        try:
            yield client
        finally:
            client.close()


@contextmanager
def their_server() -> Iterator[str]:
    def make() -> ModbusUdpServer:
        return ModbusUdpServer(simulated_device(), address=("127.0.0.1", 0))

    with in_background(make) as server:
        host, port = server.transport.get_extra_info("sockname")
        yield f"udp://{host}:{port}"


# --- their client, our server ---------------------------------------------------------------


def test_their_client_reads_every_table(theirs: Any) -> None:
    assert theirs.read_coils(10, count=5, device_id=UNIT).bits[:5] == [
        coil(n) for n in range(10, 15)
    ]
    inputs = theirs.read_discrete_inputs(20, count=5, device_id=UNIT).bits[:5]
    assert inputs == [discrete_input(n) for n in range(20, 25)]
    registers = theirs.read_holding_registers(100, count=125, device_id=UNIT).registers
    assert registers == [holding_register(n) for n in range(100, 225)]
    registers = theirs.read_input_registers(200, count=3, device_id=UNIT).registers
    assert registers == [input_register(n) for n in range(200, 203)]


def test_their_client_writes(theirs: Any) -> None:
    theirs.write_coil(11, True, device_id=UNIT)
    theirs.write_coils(12, [True, False, True], device_id=UNIT)
    assert theirs.read_coils(11, count=4, device_id=UNIT).bits[:4] == [True, True, False, True]
    theirs.write_register(100, 7, device_id=UNIT)
    theirs.write_registers(101, [8, 9], device_id=UNIT)
    theirs.mask_write_register(address=100, and_mask=0xFFF0, or_mask=0x0003, device_id=UNIT)
    assert theirs.read_holding_registers(100, count=3, device_id=UNIT).registers == [3, 8, 9]


def test_their_client_is_refused(theirs: Any) -> None:
    assert theirs.read_holding_registers(0, count=1, device_id=UNIT).exception_code == 2
    assert theirs.read_holding_registers(100, count=1, device_id=UNIT + 1).exception_code == 11


# --- our clients, their server --------------------------------------------------------------


Ask = Callable[[str, pdu.Request[Any]], Any]


def blocking(url: str, request: pdu.Request[Any]) -> Any:
    with Context.from_url(url, unit=UNIT, timeout=2) as context:
        return context.execute(request)


def in_asyncio(url: str, request: pdu.Request[Any]) -> Any:
    async def ask() -> Any:
        async with AsyncClient(url, unit=UNIT, timeout=2) as client:
            return await client.execute(request)

    return asyncio.run(ask())


@pytest.mark.parametrize("ask", [blocking, in_asyncio])
def test_our_clients_read_and_write(ask: Ask) -> None:
    with their_server() as url:
        assert ask(url, pdu.ReadCoils(10, 5)) == [coil(n) for n in range(10, 15)]
        assert ask(url, pdu.ReadDiscreteInputs(20, 9)) == [discrete_input(n) for n in range(20, 29)]
        registers = ask(url, pdu.ReadInputRegisters(200, 125))
        assert registers == [input_register(n) for n in range(200, 325)]
        assert ask(url, pdu.WriteRegisters(100, (5, 6, 7))) is None
        assert ask(url, pdu.WriteRegister(101, 9)) is None
        assert ask(url, pdu.ReadHoldingRegisters(100, 4)) == [5, 9, 7, holding_register(103)]
        assert ask(url, pdu.WriteCoils(10, (True, True))) is None
        assert ask(url, pdu.ReadCoils(10, 2)) == [True, True]
        with pytest.raises(IllegalDataAddress):
            ask(url, pdu.ReadHoldingRegisters(9999, 1))


def test_many_requests_to_their_server() -> None:
    """One at a time: pymodbus 3.16 answers one of several that come together, on TCP as well."""
    requests = [pdu.ReadHoldingRegisters(address, 2) for address in range(100, 300)]
    expected = [[holding_register(n), holding_register(n + 1)] for n in range(100, 300)]

    async def ask(url: str) -> list[Any]:
        async with AsyncClient(url, unit=UNIT, timeout=5) as client:
            return await client.execute_many(requests, max_in_flight=1)

    with their_server() as url:
        assert asyncio.run(ask(url)) == expected
        with Context.from_url(url, unit=UNIT, timeout=5) as context:
            assert context.execute_many(requests, max_in_flight=1) == expected
