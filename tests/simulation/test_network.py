"""
Time in a network in memory, and who is not there; clients' and servers' tests show all else.
"""

import struct

import pytest

from libmodbus_py import (
    AsyncClient,
    Client,
    Device,
    Fault,
    Mapping,
    ModbusConnectionError,
    ModbusTimeoutError,
    Server,
)

from .network import Network
from .scripted import Scripted
from .stage import Stage

READ = bytes.fromhex("0001 0000 0006 11 03 0002 0001")


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
        Client(peer.url, timeout=86_400) as context,
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


def test_on_a_stage_time_passes_only_while_the_test_waits() -> None:
    late = {None: [Fault("delay", seconds=500)]}
    server = Server({17: Device(Mapping(holding_registers={2: [502]}))}, faults=late)
    with Stage() as stage, server.background("tcp://10.0.0.1:0") as running:
        with stage.talk(running.urls[0], "10.0.0.2") as client:
            client.sendall(READ)
            before = stage.now
            stage.pass_time(0)
            assert stage.now == before
            assert client.recv(100)[-2:] == struct.pack(">H", 502)
            assert stage.now - before == pytest.approx(500, abs=0.001)
        with (
            Client(running.urls[0], unit=17, timeout=100) as plc,
            pytest.raises(ModbusTimeoutError),
        ):
            plc.read_holding_registers(2, 1)
        assert stage.now - before >= 600
