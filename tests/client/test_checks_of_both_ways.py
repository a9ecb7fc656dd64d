"""
What is checked of a request that C carries, and of others: the same.
"""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from libmodbus_py import (
    AsyncClient,
    ModbusConnectionError,
    ModbusTimeoutError,
    State,
    TcpContext,
    pdu,
)
from libmodbus_py.ports.schemes import SCHEMES
from tests.simulation.network import Network
from tests.simulation.scripted import Scripted
from tests.support.clients import ALL, BLOCKING, EVERYWHERE, World, asking
from tests.support.peers import dead, ignore, peer_at, until
from tests.support.reads import good

UNITS = [
    (300, ValueError),
    (256, ValueError),
    (-1, ValueError),
    (1.5, TypeError),
    (None, TypeError),
]


@ALL
@pytest.mark.parametrize(("unit", "error"), UNITS)
def test_a_unit_that_does_not_exist_is_refused_when_it_is_set(
    kind: str, unit: Any, error: type[Exception]
) -> None:
    with peer_at("tcp", good) as peer, asking(kind, peer.url) as client:
        with pytest.raises(error, match=r"unit must be .*0\.\.255"):
            client.unit = unit
        assert client.read_holding_registers(7, 1) == [7]
        assert [request[6] for request in peer.requests] == [1]


@pytest.mark.parametrize(("unit", "error"), UNITS)
def test_a_unit_that_does_not_exist_is_refused_when_it_is_submitted(
    unit: Any, error: type[Exception]
) -> None:
    network = Network()
    peer = Scripted(network, "tcp://10.0.0.1", good)

    async def main() -> None:
        async with AsyncClient(peer.url) as plc:
            waiting = asyncio.create_task(plc.read_holding_registers(7, 1))
            await asyncio.sleep(0)
            with pytest.raises(error, match=r"unit must be .*0\.\.255"):
                plc.submit(unit, pdu.ReadHoldingRegisters(1, 1), lambda: None)
            assert await waiting == [7]

    network.run(main)


class Silent(pdu.WriteRegister):
    """A write of a function that libmodbus knows, which the device is known not to answer."""

    __slots__ = ()
    expects_response = False


@EVERYWHERE
def test_a_request_without_an_answer_is_not_waited_for(world: World) -> None:
    peer = world.peer("tcp", lambda request, write: request[7] != 6 and good(request, write))
    with world.connect(peer.url, timeout=600) as client:
        assert client.read_holding_registers(1, 1) == [1]
        assert client.execute(Silent(3, 4)) is None
        assert client.read_holding_registers(2, 1) == [2]
        assert client.statistics.results[6, "silent"] == 1


@BLOCKING
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_shorter_timeout_of_another_thread_ends_the_wait(kind: str, scheme: str) -> None:
    with (
        peer_at(scheme, ignore) as peer,
        asking(kind, peer.url, timeout=600) as client,
        ThreadPoolExecutor(1) as pool,
    ):
        waiting = pool.submit(client.read_holding_registers, 1, 1)
        until(lambda: peer.requests)
        client.timeout = 0.05
        with pytest.raises(ModbusTimeoutError, match=r"within 0\.05 s"):
            waiting.result()


@BLOCKING
def test_a_shorter_timeout_of_another_thread_ends_an_attempt_to_connect(kind: str) -> None:
    with dead() as port, ThreadPoolExecutor(1) as pool:
        client = TcpContext("127.0.0.1", port, timeout=600, native=kind == "native")
        waiting = pool.submit(client.connect)
        until(lambda: client.state is State.CONNECTING)
        client.timeout = 0.05
        with pytest.raises(ModbusConnectionError):
            waiting.result()
        client.close()


@BLOCKING
def test_a_timeout_set_again_and_again_disturbs_no_request(kind: str) -> None:
    with peer_at("tcp", good) as peer, asking(kind, peer.url, timeout=600) as client:
        over = threading.Event()

        def change() -> None:
            while not over.is_set():
                client.timeout = 600.0

        thread = threading.Thread(target=change)
        thread.start()
        try:
            for address in range(300):
                assert client.read_holding_registers(address, 1) == [address]
        finally:
            over.set()
            thread.join()
        assert client.statistics.connects == 1
