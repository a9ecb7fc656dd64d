"""
The network in memory behaves as the system's does: the same scripts on both.
"""

from __future__ import annotations

import pytest

from libmodbus_py import (
    AsyncClient,
    Context,
    Device,
    Mapping,
    ModbusConnectionError,
    ModbusTimeoutError,
    Server,
)

from .network import Network
from .scripted import Scripted, Write

REGISTERS = {0: range(500, 510)}


def echo(request: bytes, write: Write) -> None:
    """Answer a read of one register over TCP with its address."""
    write(request[:4] + b"\0\5" + request[6:8] + b"\2" + request[8:10])


@pytest.mark.parametrize("url", ["tcp://10.0.0.1", "rtu+tcp://10.0.0.1", "rtu:///dev/line"])
def test_a_server_answers_asyncio_clients(url: str) -> None:
    network = Network()

    async def main() -> None:
        server = Server({17: Device(Mapping(holding_registers=REGISTERS))})
        async with server.serving(url), AsyncClient(f"{url}?unit=17") as plc:
            assert await plc.read_holding_registers(2, 2) == [502, 503]
            await plc.write_register(2, 7)
            assert await plc.read_holding_registers(2, 2) == [7, 503]

    network.run(main)


def test_pauses_between_attempts_to_connect_are_those_of_the_seed() -> None:
    def times(seed: int) -> list[float]:
        network = Network(seed)
        peer = Scripted(network, "tcp://10.0.0.1", lambda request, write: peer.drop_all())

        async def main() -> None:
            async with AsyncClient(peer.url, timeout=10) as plc:
                for _ in range(5):
                    with pytest.raises(ModbusConnectionError):
                        await plc.read_coils(0, 1)

        network.run(main)
        return peer.times

    assert times(1) == times(1) != times(2)


def test_waiting_for_an_answer_takes_simulated_seconds_only() -> None:
    network = Network()
    peer = Scripted(network, "tcp://10.0.0.1", lambda request, write: None)
    before = network.events.now
    with (
        network.installed(),
        Context.from_url(peer.url, native=False, timeout=86_400) as context,
        pytest.raises(ModbusTimeoutError, match="within 86400 s"),
    ):
        context.read_holding_registers(0, 1)
    assert 86_400 <= network.events.now - before < 86_401


def test_nobody_listens() -> None:
    network = Network()

    async def main() -> None:
        with pytest.raises(ModbusConnectionError, match="Connection refused"):
            await AsyncClient("tcp://10.0.0.1").connect()
        network.unreachable.add("10.0.0.1")
        with pytest.raises(ModbusConnectionError, match="within 7 s"):
            await AsyncClient("tcp://10.0.0.1", timeout=7).connect()
        assert network.events.now >= 1007

    network.run(main)


def test_a_dropped_connection_is_told() -> None:
    network = Network()
    peer = Scripted(network, "tcp://10.0.0.1", lambda request, write: peer.drop_all())

    async def main() -> None:
        async with AsyncClient(peer.url) as plc:
            with pytest.raises(ModbusConnectionError):
                await plc.read_holding_registers(0, 1)
            peer.on_request = echo
            assert await plc.read_holding_registers(3, 1) == [3]

    network.run(main)
    assert peer.connections == 2
